//! The files of the page, which are part of the program: there is no folder that could be left.

/// A file of the page.
#[derive(Debug, PartialEq, Eq)]
pub struct Asset {
    /// Its path in the address.
    pub path: &'static str,
    /// Its type for the browser.
    pub kind: &'static str,
    /// Its text.
    pub text: &'static str,
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! script {
    ($name:literal) => {
        Asset {
            path: concat!("/", $name),
            kind: SCRIPT,
            text: include_str!(concat!("../assets/", $name)),
        }
    };
}

/// Every file of the page.
pub(crate) static ASSETS: &[Asset] = &[
    Asset {
        path: "/",
        kind: "text/html; charset=utf-8",
        text: include_str!("../assets/page.html"),
    },
    Asset {
        path: "/page.css",
        kind: "text/css; charset=utf-8",
        text: include_str!("../assets/page.css"),
    },
    script!("main.js"),
    script!("socket.js"),
    script!("robot.js"),
    script!("touch.js"),
    script!("traces.js"),
    script!("operate.js"),
    script!("panels.js"),
    script!("scope.js"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_names_no_other_host_and_every_file_that_it_names_is_there() {
        let page = ASSETS[0].text;
        let links = page.split(['"', '\'']).filter(|word| word.starts_with('/'));
        for link in links {
            assert!(ASSETS.iter().any(|asset| asset.path == link), "{link}");
        }
        for asset in ASSETS {
            let foreign = ["http://", "https://", "//cdn", "eval(", "innerHTML", "localStorage"];
            for word in foreign {
                // The name of a vector format is no host.
                let text = asset.text.replace("http://www.w3.org/2000/svg", "");
                assert!(!text.contains(word), "{}: {word}", asset.path);
            }
        }
    }
}
