//! The JSON Schema of the configuration, for editors: made of what the reader asks for, and of what the
//! annotated configuration says.
//!
//! After a change, `PNET_NAT_SCHEMA=write cargo test --lib config::tests::schema` writes it anew.

use std::collections::{BTreeMap, HashMap};

use serde_json::{Map, Value, json};

use super::super::asked::Wanted;
use super::super::host::Unknown;
use super::super::read as read_root;
use super::reference::{REFERENCE, switched_on};
use super::*;

const FILE: &str = "config/pnet-nat.schema.json";
const SCHEMA: &str = include_str!("../../../config/pnet-nat.schema.json");
/// The section whose keys stand for those with the same name in other nets.
const MODEL: &str = "udp_range_net[]";

#[test]
fn is_made_of_what_the_reader_asks_for() {
    let made = serde_json::to_string_pretty(&schema()).unwrap() + "\n";
    if std::env::var_os("PNET_NAT_SCHEMA").is_some_and(|it| it == "write") {
        fs::write(FILE, made).unwrap();
        return;
    }
    assert!(made == SCHEMA, "PNET_NAT_SCHEMA=write cargo test --lib config::tests::schema");
}

#[test]
fn is_named_in_the_first_line_of_the_annotated_configuration() {
    assert!(REFERENCE.starts_with("#:schema ./pnet-nat.schema.json\n"));
}

#[test]
fn knows_each_kind_of_value() {
    let schema = schema();
    let of = |path: &str| schema.pointer(&format!("/properties/{path}")).unwrap();
    let net = "udp_range_net/items/properties";
    let port = of(&format!("{net}/server_port"));
    assert_eq!((&port["minimum"], &port["maximum"]), (&json!(1), &json!(65535)));
    assert_eq!(port["default"], 34379);
    assert_eq!(of("datapath/properties/prefilter")["enum"], json!(["auto", "always", "off"]));
    assert_eq!(of("datapath/properties/kernel")["enum"], json!(["auto", "off", "required"]));
    assert_eq!(of("runtime/properties/user")["anyOf"].as_array().unwrap().len(), 2);
    let required = &of("udp_range_net/items")["required"];
    assert_eq!(required, &json!(["allow", "name", "nodes", "start_port", "subnet"]));
    let password = of(&format!("{net}/password/items"));
    assert_eq!(password["required"], json!(["file", "name"]));
    for (path, description) in keys(&schema, "") {
        assert!(!description.is_empty(), "{path} has no description");
    }
}

/// The keys of a schema with their descriptions.
fn keys(schema: &Value, path: &str) -> Vec<(String, String)> {
    let object = schema.get("items").unwrap_or(schema);
    let properties = object.get("properties").and_then(Value::as_object);
    let of_key = |(key, schema): (&String, &Value)| {
        let path = format!("{path}.{key}");
        let description = schema["description"].as_str().unwrap_or_default().to_owned();
        let below = keys(schema, &path);
        std::iter::once((path, description)).chain(below).collect::<Vec<_>>()
    };
    properties.into_iter().flatten().flat_map(of_key).collect()
}

fn schema() -> Value {
    let schema = Schema { asked: asked(), told: told() };
    let Value::Object(mut root) = schema.object("") else { unreachable!() };
    root.insert("$schema".into(), "http://json-schema.org/draft-07/schema#".into());
    root.insert("title".into(), "Configuration of pnet-nat".into());
    let beyond =
        "What a schema cannot say, such as that two nets have one port, `pnet-nat check` finds.";
    root.insert("description".into(), beyond.into());
    root.into()
}

/// What the reader asks for in configurations that have every key, and each kind of value that a key may
/// have.
fn asked() -> BTreeMap<String, Vec<Wanted>> {
    let all = switched_on();
    let other = all
        .replace("user = \"pnet-nat\"", "user = 1000")
        .replace("wrong_password_burst = 10", "wrong_password_burst = 1");
    assert_ne!(all, other);
    let mut asked = BTreeMap::<String, Vec<Wanted>>::new();
    for text in [all, other] {
        let report = Report::new(Path::new("pnet-nat.toml"), &text);
        let (document, errors) = DeTable::parse_recoverable(&text);
        assert!(errors.is_empty(), "{errors:?}");
        read_root(Section::root(document.get_ref(), &report), &Unknown, None);
        for (path, wanted) in report.asked.into_inner() {
            asked.entry(path).or_default().extend(wanted);
        }
    }
    asked
}

struct Schema {
    asked: BTreeMap<String, Vec<Wanted>>,
    told: HashMap<String, Told>,
}

impl Schema {
    /// A table with the keys right below `path`.
    fn object(&self, path: &str) -> Value {
        let prefix = if path.is_empty() { String::new() } else { format!("{path}.") };
        let (mut properties, mut required) = (Map::new(), Vec::new());
        for (key_path, wanted) in &self.asked {
            let Some(key) = key_path.strip_prefix(&prefix) else { continue };
            if key.contains(['.', '[']) {
                continue;
            }
            properties.insert(key.to_owned(), self.key(key_path));
            if wanted.contains(&Wanted::Required) {
                required.push(key);
            }
        }
        let mut object =
            json!({ "type": "object", "properties": properties, "additionalProperties": false });
        if !required.is_empty() {
            object["required"] = json!(required);
        }
        object
    }

    /// The value at a key, with what the annotated configuration says of it.
    fn key(&self, path: &str) -> Value {
        let mut schema = self.value(path);
        let Some(told) = self.told.get(path) else { panic!("{path} is not in the annotated file") };
        let key = path.rsplit('.').next().unwrap();
        let model = || {
            let below = if path.contains(".password[]") { ".password[]" } else { "" };
            Some(self.told.get(&format!("{MODEL}{below}.{key}"))?.description.clone())
        };
        let own = Some(told.description.clone()).filter(|own| !own.is_empty());
        schema["description"] = own.or_else(model).unwrap_or_default().into();
        let is_required = self.asked[path].contains(&Wanted::Required);
        match &told.value {
            Some(value) if told.is_example || is_required => schema["examples"] = json!([value]),
            Some(value) => schema["default"] = value.clone(),
            None => {}
        }
        schema
    }

    fn value(&self, path: &str) -> Value {
        let asked = &self.asked[path];
        let texts =
            asked.iter().any(|wanted| matches!(wanted, Wanted::OneOf(_) | Wanted::Duration));
        let mut bounds: Option<(i64, i64)> = None;
        let mut kinds = Vec::new();
        for wanted in asked {
            kinds.push(match wanted {
                Wanted::Key | Wanted::Required => continue,
                Wanted::Text if texts => continue, // read as a text, and then as more
                Wanted::Boolean => json!({ "type": "boolean" }),
                Wanted::Text => json!({ "type": "string" }),
                Wanted::OneOf(labels) => json!({ "type": "string", "enum": labels }),
                Wanted::Duration => json!({ "type": "string", "pattern": "^[0-9]" }),
                Wanted::List => json!({
                    "type": "array", "items": self.value(&format!("{path}[]")), "minItems": 1
                }),
                Wanted::Section => self.object(path),
                Wanted::Sections => {
                    json!({ "type": "array", "items": self.object(&format!("{path}[]")) })
                }
                // The widest, where another key narrows them.
                Wanted::Integer(first, last) => {
                    let (from, to) = bounds.unwrap_or((*first, *last));
                    bounds = Some((from.min(*first), to.max(*last)));
                    continue;
                }
            });
        }
        let integer = |(first, last): (i64, i64)| json!({ "type": "integer", "minimum": first, "maximum": last });
        kinds.extend(bounds.map(integer));
        kinds.dedup();
        match kinds.len() {
            0 => panic!("nothing is read at {path}: no configuration above has such a value"),
            1 => kinds.remove(0),
            _ => json!({ "anyOf": kinds }),
        }
    }
}

/// What the annotated configuration says of a key.
struct Told {
    description: String,
    /// None for a section.
    value: Option<Value>,
    /// It is commented out, so its value is no default.
    is_example: bool,
}

fn told() -> HashMap<String, Told> {
    let mut told = HashMap::new();
    let (mut comment, mut title, mut section) = (Vec::new(), String::new(), String::new());
    for line in REFERENCE.lines().map(str::trim_start) {
        let (is_example, key) = match line.strip_prefix('#') {
            Some(rest) => (rest.starts_with(|c: char| c.is_ascii_lowercase() || c == '['), rest),
            None => (false, line),
        };
        if let Some(heading) = line.strip_prefix("# ── ") {
            title = heading.trim_end_matches(['─', ' ']).to_owned();
        } else if line.starts_with('#') && !is_example {
            comment.push(key.strip_prefix(' ').unwrap_or(key));
        } else if let Some(header) = key.strip_prefix('[') {
            let (path, keys) = places(header);
            let own = description(&std::mem::take(&mut comment));
            let description = if own.is_empty() { title.clone() } else { own };
            told.entry(path).or_insert(Told { description, value: None, is_example });
            section = keys;
        } else if let Some((key, value)) = key.split_once(" = ") {
            let value = toml::from_str::<toml::Table>(&format!("value = {value}")).unwrap();
            let value = serde_json::to_value(&value["value"]).unwrap();
            let description = description(&std::mem::take(&mut comment));
            let path = format!("{section}.{key}");
            told.insert(path, Told { description, value: Some(value), is_example });
        } else {
            comment.clear();
        }
    }
    told
}

/// The path of a section by its header, and the path of what is in it.
fn places(header: &str) -> (String, String) {
    let (lists, header) = (header.starts_with('['), header.trim_matches(['[', ']']));
    let path = header.replace('.', "[].");
    let keys = if lists { format!("{path}[]") } else { path.clone() };
    (path, keys)
}

fn description(comment: &[&str]) -> String {
    let text = comment.join("\n");
    text.strip_prefix("Required.").unwrap_or(&text).trim().to_owned()
}
