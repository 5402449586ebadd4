//! The client's sheet as a page, in a real browser: what is handed out is read on a desk, a phone and paper.

use std::fs;
use std::path::Path;

use serde_json::json;

use crate::harness::{ANNOTATED, Browser, Process, folder, pnet_nat};
use crate::status_page::AXE;

const SCREENSHOTS: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/client-sheet");

#[test]
fn the_sheet_is_read_everywhere_and_needs_nothing_else() {
    let Some(browser) = Browser::start() else { return };
    let folder = folder(&ANNOTATED.replace("\"172.17.", "\"127.17."));
    let mut command = pnet_nat(&["check", "--config", "pnet-nat.toml", "--client-sheet", "html"]);
    command.current_dir(folder.path());
    let mut made = Process::start(command);
    assert_eq!(made.end(), Some(0), "{}", made.stderr());
    let page = folder.path().join("client-sheet.html");
    fs::write(&page, made.stdout()).unwrap();

    fs::create_dir_all(SCREENSHOTS).unwrap();
    for (name, width, is_phone, scheme) in [
        ("light", 1280, false, "light"),
        ("dark", 1280, false, "dark"),
        ("phone", 390, true, "light"),
    ] {
        browser.look(width, 900, is_phone, scheme);
        browser.open(&format!("file://{}", page.display()));
        browser.expect("h1", "Set up a P-NET client");
        for field in ["IPAddr", "UDPPort", "UsePW", "Router", "Nettype", "Password"] {
            let rows = format!(
                "return Array.from(document.querySelectorAll('th')).filter((th) => th.innerText === '{field}').length"
            );
            assert_eq!(browser.run(&rows), 2, "{field}: one for each net");
        }
        browser.expect(
            "section:last-of-type",
            "the node address of the router on the client's own net",
        );
        let too_wide =
            "const page = document.documentElement; return page.scrollWidth - page.clientWidth";
        assert_eq!(browser.run(too_wide), json!(0), "{name}: nothing is cut off");
        if let Some(faults) = browser.accessibility_faults(Path::new(AXE)) {
            assert_eq!(faults, [""; 0], "{name}");
        }
        browser.screenshot(&Path::new(SCREENSHOTS).join(format!("{name}.png")));
    }
    assert_eq!(browser.errors(), [""; 0]);
}
