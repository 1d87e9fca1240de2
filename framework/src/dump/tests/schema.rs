//! Checks the JSON of dumps against `docs/dump.schema.json`, and the schema against `docs/dump.md`.

use serde_json::Value;
use std::collections::BTreeSet;

use super::encoders::encoded;
use super::example::{self, dump};
use super::timed;
use crate::dump::json;
use crate::ir::{DepthAccess, DepthTarget};

const SCHEMA: &str = include_str!("../../../../docs/dump.schema.json");
const PAGE: &str = include_str!("../../../../docs/dump.md");

/// Validates JSON against the part of JSON Schema (2020-12) that this schema uses.
struct Validator<'a> {
    root: &'a Value,
    /// Schema paths of the fields seen with a value other than null or an empty list.
    seen: BTreeSet<String>,
}

impl<'a> Validator<'a> {
    /// Checks a value. `at` is the path of `schema` in the schema file, `path` the path of `value` in the dump.
    fn check(&mut self, schema: &'a Value, at: &str, value: &Value, path: &str) -> Result<(), String> {
        let fail = |what: String| Err(format!("{path}: {what} (by {at}): {value:.80}"));
        for (keyword, rule) in schema.as_object().expect("a schema is an object") {
            match keyword.as_str() {
                "$schema" | "title" | "description" | "$defs" | "required" | "additionalProperties" => {}
                "$ref" => {
                    let pointer = rule.as_str().and_then(|r| r.strip_prefix('#')).expect("within the file");
                    let target = self.root.pointer(pointer).unwrap_or_else(|| panic!("no {pointer}"));
                    self.check(target, pointer, value, path)?;
                }
                "anyOf" | "oneOf" => {
                    let alternatives = rule.as_array().expect("a list").iter().enumerate();
                    let tries =
                        alternatives.map(|(i, s)| self.check(s, &format!("{at}/{keyword}/{i}"), value, path));
                    let good = tries.filter(Result::is_ok).count();
                    if good == 0 || (keyword == "oneOf" && good > 1) {
                        return fail(format!("{good} of {keyword} fit"));
                    }
                }
                "const" if rule != value => return fail(format!("is not {rule}")),
                "enum" if !rule.as_array().expect("a list").contains(value) => {
                    return fail(format!("is not one of {rule}"));
                }
                "const" | "enum" => {}
                "type" if !of_type(rule, value) => return fail(format!("is not of type {rule}")),
                "type" => {}
                "minimum" if value.as_f64() < rule.as_f64() && value.is_number() => {
                    return fail(format!("is less than {rule}"));
                }
                "minimum" => {}
                "minItems" | "maxItems" => {
                    let (length, bound) =
                        (value.as_array().map_or(0, Vec::len) as u64, rule.as_u64().unwrap());
                    if (keyword == "minItems" && length < bound) || (keyword == "maxItems" && length > bound)
                    {
                        return fail(format!("has {length} elements"));
                    }
                }
                "items" => {
                    for (i, element) in value.as_array().into_iter().flatten().enumerate() {
                        self.check(rule, &format!("{at}/items"), element, &format!("{path}/{i}"))?;
                    }
                }
                "properties" => self.check_fields(schema, at, value, path)?,
                _ => panic!("the validator does not know {keyword}, at {at}"),
            }
        }
        if let (None, Some(rule)) = (schema.get("properties"), schema.get("additionalProperties")) {
            for (name, value) in value.as_object().into_iter().flatten() {
                self.check(rule, &format!("{at}/additionalProperties"), value, &format!("{path}/{name}"))?;
            }
        }
        Ok(())
    }

    fn check_fields(&mut self, schema: &'a Value, at: &str, value: &Value, path: &str) -> Result<(), String> {
        let properties = schema["properties"].as_object().expect("an object");
        let Some(fields) = value.as_object() else { return Err(format!("{path}: not an object, by {at}")) };
        assert_eq!(schema["additionalProperties"], false, "{at} would let anything pass");
        if let Some(name) = fields.keys().find(|name| !properties.contains_key(*name)) {
            return Err(format!("{path}: the field {name} is not in the schema, at {at}"));
        }
        for required in schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            if !fields.contains_key(required) {
                return Err(format!("{path}: the field {required} is missing, by {at}"));
            }
        }
        for (name, value) in fields {
            let place = format!("{at}/properties/{name}");
            self.check(&properties[name], &place, value, &format!("{path}/{name}"))?;
            if !value.is_null() && value.as_array().is_none_or(|list| !list.is_empty()) {
                self.seen.insert(place);
            }
        }
        Ok(())
    }
}

fn of_type(rule: &Value, value: &Value) -> bool {
    let is = |name: &str| match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        _ => panic!("there is no type {name}"),
    };
    match rule {
        Value::String(name) => is(name),
        Value::Array(names) => names.iter().filter_map(Value::as_str).any(is),
        _ => panic!("a type is a name or a list of names"),
    }
}

/// Adds the schema paths that describe fields to `found`.
fn described(schema: &Value, at: &str, found: &mut BTreeSet<String>) {
    match schema {
        Value::Object(map) => {
            for (key, value) in map {
                let place = format!("{at}/{key}");
                if key == "properties" {
                    found
                        .extend(value.as_object().expect("an object").keys().map(|n| format!("{place}/{n}")));
                }
                described(value, &place, found);
            }
        }
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, value)| described(value, &format!("{at}/{i}"), found));
        }
        _ => {}
    }
}

fn schema() -> Value {
    serde_json::from_str(SCHEMA).expect("the schema is JSON")
}

#[test]
fn a_dump_has_the_fields_of_the_schema_and_no_others() {
    let schema = schema();
    let mut validator = Validator { root: &schema, seen: BTreeSet::new() };
    let encoded = encoded(dump(&example::splat(4)));
    let mut tested = dump(&example::splat(4));
    let image = tested.output.clone();
    let draw = tested.passes.iter_mut().find(|pass| pass.topology.is_some()).expect("a draw");
    draw.depth = Some(DepthTarget { image, access: DepthAccess::Test });
    for dump in [timed(example::splat(8)), encoded, tested] {
        if let Err(error) = validator.check(&schema, "", &json(&dump), "") {
            panic!("{error}");
        }
    }
    let mut all = BTreeSet::new();
    described(&schema, "", &mut all);
    let unused: Vec<_> = all.difference(&validator.seen).collect();
    assert!(unused.is_empty(), "no dump has a value for {unused:#?}");
}

#[test]
fn the_validator_finds_what_does_not_fit() {
    let schema = schema();
    let good = json(&dump(&example::splat(4)));
    let broken: [fn(&mut Value); 6] = [
        |dump| dump["version"] = 1.into(),
        |dump| dump["surplus"] = 1.into(),
        |dump| drop(dump["totals"].as_object_mut().unwrap().remove("passes")),
        |dump| dump["passes"][0]["run"] = "Sometimes".into(),
        |dump| dump["resources"][0]["bytes"] = (-1).into(),
        |dump| dump["passes"][3]["barriers"][0]["dependencies"] = Value::Array(vec![]),
    ];
    for (i, change) in broken.iter().enumerate() {
        let mut bad = good.clone();
        change(&mut bad);
        let mut validator = Validator { root: &schema, seen: BTreeSet::new() };
        assert!(validator.check(&schema, "", &bad, "").is_err(), "change {i} was not found");
    }
}

fn documented(heading: &str) -> Vec<&str> {
    let (_, section) =
        PAGE.split_once(&format!("\n### {heading}\n")).unwrap_or_else(|| panic!("no section {heading}"));
    let section = section.split("\n### ").next().unwrap_or(section);
    section.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect()
}

#[test]
fn the_documentation_has_the_fields_of_the_schema() {
    let schema = schema();
    let definitions = schema["$defs"].as_object().expect("an object");
    let named = definitions.iter().map(|(name, schema)| (name.as_str(), schema));
    for (name, schema) in named.chain([("dump", &schema)]) {
        if let Some(properties) = schema.get("properties").and_then(Value::as_object) {
            assert_eq!(documented(name), properties.keys().collect::<Vec<_>>(), "under {name}");
        }
    }
}

#[test]
fn the_page_knows_every_kind_of_pass_and_every_source_of_the_schema() {
    let schema = schema();
    for (of, field, script, list) in [
        ("pass", "kind", include_str!("../page/timeline.js"), "const ICONS = {\n"),
        ("resource", "source", include_str!("../page/panel.js"), "const sources = {\n"),
    ] {
        let values = schema["$defs"][of]["properties"][field]["enum"].as_array().expect("a list");
        let values: BTreeSet<&str> = values.iter().filter_map(Value::as_str).collect();
        let (_, entries) = script.split_once(list).expect("the list is there");
        let (entries, _) = entries.split_once("};").expect("it ends");
        let entries = entries.lines().filter_map(|line| Some(line.trim().split_once(": ")?.0)).collect();
        assert_eq!(values, entries, "`{list}` in framework/src/dump/page/");
    }
}
