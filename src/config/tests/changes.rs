//! What a reload tells of the keys that were changed.

use super::hash::each_key;
use super::reference::{read as read_reference, switched_on, switched_on_with};
use super::remote_net::ADAPTER;
use super::*;

#[test]
fn each_key_that_was_changed_is_told() {
    let sound = |text: &str| read_reference(text).unwrap_or_else(|faults| panic!("{faults}")).0;
    let old = sound(&switched_on());
    for (path, value) in each_key() {
        let (section, key) = path.rsplit_once('.').unwrap();
        let mut new = sound(&switched_on_with(section, key, value));
        let settled = keep_settled(&old, &mut new);
        let changes = Changes::between(&old, &new);
        assert!(changes != Changes::default() || !settled.is_empty(), "{path} = {value}");
    }
}

/// Requests get the first password. So the order is a rule, where for other nets it is none.
#[test]
fn another_password_that_is_sent_is_told() {
    let of = |[first, second]: [&str; 2]| {
        let more =
            format!("[[remote_net.password]]\nname = \"{second}\"\nfile = \"secrets/{second}\"\n");
        let one = ADAPTER.replace("\"service\"", &format!("\"{first}\""));
        read(&format!("{}{more}", one.replace("secrets/a", &format!("secrets/{first}")))).unwrap().0
    };
    let expected = Changes { nets_changed: vec!["plant-2".into()], ..Changes::default() };
    assert_eq!(Changes::between(&of(["a", "b"]), &of(["b", "a"])), expected);
}
