//! Every statusword beside the patterns of the standard, written as the standard prints them.

use taktil_drivers_cia402::{Inconsistency, State, Statusword};

/// Bits 15 to 0 of the statusword in each state; `x` is a bit that the state leaves open.
const PATTERNS: [(&str, State); 8] = [
    ("xxxx xxxx x0xx 0000", State::NotReadyToSwitchOn),
    ("xxxx xxxx x1xx 0000", State::SwitchOnDisabled),
    ("xxxx xxxx x01x 0001", State::ReadyToSwitchOn),
    ("xxxx xxxx x01x 0011", State::SwitchedOn),
    ("xxxx xxxx x01x 0111", State::OperationEnabled),
    ("xxxx xxxx x00x 0111", State::QuickStopActive),
    ("xxxx xxxx x0xx 1111", State::FaultReactionActive),
    ("xxxx xxxx x0xx 1000", State::Fault),
];

fn fits(pattern: &str, word: u16) -> bool {
    let bits: Vec<char> = pattern.chars().filter(|bit| *bit != ' ').collect();
    assert_eq!(bits.len(), 16, "{pattern}");
    bits.iter().enumerate().all(|(place, bit)| match bit {
        'x' => true,
        '0' => word & (0x8000 >> place) == 0,
        _ => word & (0x8000 >> place) != 0,
    })
}

#[test]
fn every_word_shows_the_state_whose_pattern_it_fits_or_none() {
    let mut legal = 0;
    for word in 0..=u16::MAX {
        let due: Vec<State> = PATTERNS
            .iter()
            .filter(|(pattern, _)| fits(pattern, word))
            .map(|(_, state)| *state)
            .collect();
        assert!(due.len() <= 1, "{word:04x} fits {due:?}");
        assert_eq!(Statusword(word).state().ok(), due.first().copied(), "{word:04x}");
        legal += due.len();
    }
    // Six bits can form 64 words, and twelve of them are legal.
    assert_eq!(legal, 12 * 1024);
}

#[test]
fn every_illegal_word_is_named() {
    let mut counts = std::collections::BTreeMap::new();
    for word in 0..=u16::MAX {
        let Err(name) = Statusword(word).state() else { continue };
        let bit = |number: u16| word & (1 << number) != 0;
        let due = if bit(6) {
            Inconsistency::DisabledAndActive
        } else if bit(3) {
            Inconsistency::PartOfFault
        } else if bit(2) && !(bit(1) && bit(0)) || bit(1) && !bit(0) {
            Inconsistency::StepOmitted
        } else {
            assert!(!bit(5) && bit(0) && !bit(2), "{word:04x}");
            Inconsistency::QuickStopWithoutOperation
        };
        assert_eq!(name, due, "{word:04x}");
        *counts.entry(name).or_insert(0) += 1;
    }
    assert_eq!(counts.values().copied().collect::<Vec<u32>>(), [30, 12, 8, 2].map(|n| n * 1024));
}

#[test]
fn the_other_bits_are_where_the_standard_puts_them() {
    for bit in 0..16 {
        let word = Statusword(1 << bit);
        let seen = [
            word.has_voltage(),
            word.has_warning(),
            word.is_remote(),
            word.has_internal_limit(),
            word.has_following_error(),
        ];
        assert_eq!(seen, [4, 7, 9, 11, 13].map(|place| place == bit), "bit {bit}");
    }
    for word in 0..=u16::MAX {
        let word = Statusword(word);
        let state = word.state();
        assert_eq!(word.is_enabled(), state == Ok(State::OperationEnabled));
        assert_eq!(word.is_following(), word.is_enabled() && word.0 & 0x1000 != 0);
        assert_eq!(word.is_fault(), state.is_ok_and(State::is_fault));
    }
}
