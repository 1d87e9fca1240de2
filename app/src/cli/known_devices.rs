//! Describes devices of other machines, from a catalogue of published limits, and from files of facts.

use crate::draw::facts;
use crate::draw::fit::Target;
use crate::io::own_file;
use anyhow::{Context, Result, bail};
use serde_json::{Map, Value};
use splatgraph_framework::ir::{DeviceFacts, Features, Value as Fact};
use std::path::Path;

/// Lists the devices of the catalogue, each with the source of its limits.
///
/// An entry for a family of devices has the smallest limits of its members. An unpublished limit is taken from the
/// least capable supported device.
pub fn catalogue() -> Vec<(Target, &'static str)> {
    let portable = facts::portable_device;
    let with = |device: DeviceFacts, more| DeviceFacts { features: device.features | more, ..device };
    let stores = Features::FRAGMENT_STORES | Features::VERTEX_STORES;
    let float_atomics =
        Features::BUFFER_FLOAT_ATOMICS | Features::SHARED_FLOAT_ATOMICS | Features::IMAGE_FLOAT_ATOMICS;
    let float_additions = Features::BUFFER_FLOAT_ATOMIC_ADD
        | Features::SHARED_FLOAT_ATOMIC_ADD
        | Features::IMAGE_FLOAT_ATOMIC_ADD;
    let wide = Features::INT64 | Features::FLOAT64;
    let device = |name: &str, facts, storage_buffers, source| {
        // Only WebGPU's limit of storage images is below the other devices' limits.
        let storage_images = name.starts_with("webgpu").then_some(4);
        (Target { storage_buffers, storage_images, ..Target::new(name, facts) }, source)
    };
    let limits = |lanes, max_storage_bytes, max_invocations, shared_kib: u32| DeviceFacts {
        max_storage_bytes,
        max_invocations,
        shared_bytes: shared_kib << 10,
        ..portable(lanes)
    };
    let webgpu = DeviceFacts { max_image_size: 8192, ..portable(facts::USUAL_SUBGROUP_SIZE) };
    let webgpu = with(webgpu, Features::FRAGMENT_STORES);
    let most = u64::from(u32::MAX);
    vec![
        device(
            "lavapipe",
            with(limits(8, 1 << 27, 1024, 32), stores | wide | float_atomics | float_additions),
            None,
            "Mesa 22.3, on a CPU with vectors of 256 bits",
        ),
        device(
            "raspberry-pi-5",
            with(DeviceFacts { max_image_size: 4096, ..limits(16, 1 << 30, 256, 16) }, stores),
            Some(64),
            "Mesa, src/broadcom/vulkan/v3dv_device.c: V3D 7.1",
        ),
        device(
            "adreno",
            with(limits(128, 1 << 29, 1024, 32), stores),
            None,
            "Mesa, src/freedreno/vulkan/tu_device.cc: Adreno 6xx and 7xx, subgroups of the usual size",
        ),
        device(
            "mali",
            limits(16, most, 512, 32),
            None,
            "Mesa, src/panfrost/vulkan/panvk_vX_physical_device.c: Valhall; cores run workgroups of 512 or 1,024",
        ),
        device(
            "intel",
            with(limits(32, 1 << 30, 1024, 64), stores | Features::INT64 | float_atomics),
            None,
            "Mesa, src/intel/vulkan: Xe, subgroups of the usual size",
        ),
        device(
            "amd",
            with(
                limits(64, most, 1024, 64),
                stores | wide | float_atomics | Features::SHARED_FLOAT_ATOMIC_ADD,
            ),
            None,
            "Mesa, src/amd/vulkan: GCN 3 and newer, subgroups of the usual size",
        ),
        device(
            "apple",
            with(facts::apple_device(), stores),
            Some(facts::DESKTOP_STORAGE_BUFFERS),
            "Apple, Metal Feature Set Tables: family Apple 7",
        ),
        device(
            "webgpu",
            DeviceFacts { features: Features::FRAGMENT_STORES, ..webgpu },
            Some(8),
            "W3C, WebGPU: default limits, without the feature `subgroups`",
        ),
        device(
            "webgpu-subgroups",
            webgpu,
            Some(8),
            "W3C, WebGPU: default limits, with the feature `subgroups`",
        ),
    ]
}

/// Finds a device by name in the catalogue, or reads a file of device facts; `None` if there is neither.
///
/// # Errors
/// The file cannot be read, or does not contain the facts of a device.
pub fn find(wanted: &str) -> Result<Option<Target>> {
    if let Some((found, _)) = catalogue().into_iter().find(|(device, _)| device.name == wanted) {
        return Ok(Some(found));
    }
    let path = Path::new(wanted);
    if !path.is_file() {
        return Ok(None);
    }
    let text = own_file::read(path).with_context(|| format!("{wanted} cannot be read"))?;
    from_json(wanted, &text).with_context(|| format!("{wanted} does not describe a device")).map(Some)
}

/// Parses device facts from a list of devices (the first one counts), from one device, or from the facts alone. `name`
/// is used if the text names no device.
fn from_json(name: &str, text: &[u8]) -> Result<Target> {
    let value: Value = serde_json::from_slice(text)?;
    let device = match &value {
        Value::Array(all) => all.first().context("expected a device, found an empty list")?,
        other => other,
    };
    let facts = device.get("facts").unwrap_or(device);
    let facts =
        facts.as_object().context("expected an object of facts, such as {\"device.subgroup_size\": 32}")?;
    if facts.is_empty() {
        bail!("expected facts, such as {{\"device.subgroup_size\": 32}}, found none");
    }
    let name = device.get("name").and_then(Value::as_str).unwrap_or(name);
    let mut facts = read(facts)?;
    for feature in device.get("features").and_then(Value::as_array).into_iter().flatten() {
        let known = feature.as_str().and_then(Features::from_name);
        facts.features |=
            known.with_context(|| format!("expected the name of a feature, found {feature}"))?;
    }
    Ok(Target::new(name, facts))
}

/// Reads facts by the names that graphs use. A missing fact is taken from the least capable supported device.
fn read(named: &Map<String, Value>) -> Result<DeviceFacts> {
    let mut facts = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
    for (name, value) in named {
        let value = match value {
            Value::Bool(truth) => Fact::Bool(*truth),
            Value::Number(number) if number.is_u64() => {
                Fact::Int(number.as_u64().and_then(|number| number.try_into().ok()).unwrap_or(i64::MAX))
            }
            other => Fact::Text(other.to_string()),
        };
        facts::set_device_fact(&mut facts, name, &value).map_err(anyhow::Error::msg)?;
    }
    Ok(facts)
}

pub fn list() -> String {
    let row = |(device, source): (Target, &str)| (device.name, source.to_owned());
    super::help::two_columns(catalogue().into_iter().map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_facts_of_each_device_come_back_from_what_devices_writes_of_them() {
        for (device, _) in catalogue() {
            let listed = serde_json::json!([{ "name": device.name, "facts": device.facts }]);
            let read = from_json("x.json", listed.to_string().as_bytes()).expect("facts");
            // Vulkan guarantees the basic operations of subgroups, so they have no fact.
            let features = device.facts.features | Features::SUBGROUP_BASIC;
            let expected = DeviceFacts { features, ..device.facts };
            assert_eq!((&read.name, read.facts), (&device.name, expected));
            let alone = from_json("x.json", listed[0]["facts"].to_string().as_bytes()).expect("facts");
            assert_eq!((alone.name.as_str(), alone.facts), ("x.json", read.facts));
            let mut all = listed.clone();
            all[0]["features"] = Features::all().iter_names().map(|(name, _)| name).collect();
            let read = from_json("x.json", all.to_string().as_bytes()).expect("facts and features");
            assert_eq!(read.facts.features, Features::all());
        }
        let lavapipe = find("lavapipe").expect("a name").expect("a device");
        assert!(lavapipe.facts.features.contains(Features::FLOAT64));
    }

    #[test]
    fn a_file_without_a_devices_facts_is_refused_with_the_name_of_the_fact() {
        let error = |text: &str| format!("{:#}", from_json("x.json", text.as_bytes()).expect_err("no facts"));
        assert!(error(r#"{"device.lanes": 32}"#).ends_with("found `device.lanes`"));
        assert_eq!(error(r#"{"device.int64": 1}"#), "expected true or false for `device.int64`, found 1");
        assert_eq!(
            error(r#"{"device.shared_bytes": -1}"#),
            "expected a natural number for `device.shared_bytes`, found -1"
        );
        assert!(error(r#"{"device.subgroup_size": 24}"#).contains("found 24"));
        let unknown = error(r#"{"facts": {"device.int64": true}, "features": ["FLYING"]}"#);
        assert_eq!(unknown, "expected the name of a feature, found \"FLYING\"");
        assert_eq!(error("[]"), "expected a device, found an empty list");
        for empty in ["{}", r#"{"name": "x", "facts": {}}"#] {
            assert!(error(empty).starts_with("expected facts, such as "), "{}", error(empty));
        }
        assert!(find("no-such-device").expect("no file").is_none());
    }
}
