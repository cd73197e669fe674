//! The page of faults in the manual is the table of the code.

/// The page, from the repository's root.
const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/guides/faults.md");

#[test]
fn the_manual_s_table_of_faults_is_the_one_of_the_code() {
    let page = std::fs::read_to_string(PAGE).unwrap();
    let table = taktil_rtcore::fault::table();
    assert!(page.contains(&table), "the table of {PAGE} should be:\n{table}");
}
