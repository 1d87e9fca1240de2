//! Chooses one of the machine's devices.

use splatgraph_api::{BackendError, DeviceInfo};

/// Returns the position in `devices` of the chosen device. `wanted` is a [`DeviceInfo::index`], or part of a name
/// (case-insensitive).
///
/// A number that is not an index must match a whole word of the name: `4090` chooses an RTX 4090, but `1` does not
/// choose an H100.
///
/// Without `wanted`, prefers the first usable discrete GPU, then an integrated GPU, then any other, CPUs last.
///
/// # Errors
/// [`BackendError::Unavailable`] if no device matches, or if the chosen device cannot run plans.
pub fn choose(devices: &[&DeviceInfo], wanted: Option<&str>) -> Result<usize, BackendError> {
    let found = match wanted {
        Some(text) => {
            let part = text.trim().to_lowercase();
            let index: Option<usize> = part.parse().ok();
            let by_index = devices.iter().position(|device| Some(device.index) == index);
            by_index
                .or_else(|| devices.iter().position(|device| is_named(&device.name.to_lowercase(), &part)))
        }
        None => (0..devices.len())
            .filter(|&place| devices[place].unfit.is_none())
            .min_by_key(|&place| preference(&devices[place].kind))
            .or((!devices.is_empty()).then_some(0)),
    };
    let Some(found) = found else {
        let listed: Vec<String> = devices.iter().map(|d| format!("{}: {}", d.index, d.name)).collect();
        let wanted = wanted.map(|text| format!(" `{text}`")).unwrap_or_default();
        return Err(BackendError::Unavailable(format!(
            "there is no device{wanted}; available: {}",
            listed.join(", ")
        )));
    };
    match &devices[found].unfit {
        Some(why) => {
            Err(BackendError::Unavailable(format!("{} cannot run plans: {why}", devices[found].name)))
        }
        None => Ok(found),
    }
}

fn is_named(name: &str, part: &str) -> bool {
    if part.bytes().all(|byte| byte.is_ascii_digit()) {
        // A version ("15.0.6") is one word. An empty part matches nothing.
        let mut words = name.split(|c: char| !c.is_alphanumeric() && c != '.');
        return !part.is_empty() && words.any(|word| word == part);
    }
    name.contains(part)
}

fn preference(kind: &str) -> u32 {
    match kind {
        "discrete" => 0,
        "integrated" => 1,
        "virtual" => 2,
        "cpu" => 4,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_api::{Heap, Robustness};
    use splatgraph_framework::ir::DeviceFacts;

    fn device(index: usize, name: &str, kind: &str, unfit: Option<&str>) -> DeviceInfo {
        DeviceInfo {
            index,
            name: name.to_string(),
            kind: kind.to_string(),
            driver: String::new(),
            facts: DeviceFacts::default(),
            robustness: Robustness::default(),
            heap: Heap::default(),
            unfit: unfit.map(str::to_string),
        }
    }

    fn chosen(devices: &[DeviceInfo], wanted: Option<&str>) -> Result<usize, String> {
        choose(&devices.iter().collect::<Vec<_>>(), wanted).map_err(|error| error.to_string())
    }

    #[test]
    fn a_discrete_gpu_comes_before_an_integrated_one_and_a_cpu_last() {
        let all = [
            device(0, "llvmpipe", "cpu", None),
            device(1, "Apple M1", "integrated", None),
            device(2, "RTX 4090", "discrete", None),
        ];
        assert_eq!(chosen(&all, None), Ok(2));
        assert_eq!(chosen(&all[..2], None), Ok(1));
        assert_eq!(chosen(&all[..1], None), Ok(0));
    }

    #[test]
    fn a_device_is_named_by_its_index_or_a_part_of_its_name() {
        let all = [device(0, "llvmpipe", "cpu", None), device(1, "RTX 4090", "discrete", None)];
        assert_eq!(chosen(&all, Some("0")), Ok(0));
        assert_eq!(chosen(&all, Some("LLVM")), Ok(0));
        assert_eq!(chosen(&all, Some("4090")), Ok(1));
        let missing = chosen(&all, Some("radeon")).unwrap_err();
        assert!(missing.contains("`radeon`; available: 0: llvmpipe, 1: RTX 4090"), "{missing}");
    }

    #[test]
    fn a_number_that_is_no_index_chooses_only_a_device_with_this_word_in_its_name() {
        let all = [
            device(0, "llvmpipe (LLVM 15.0.6, 256 bits)", "cpu", None),
            device(1, "NVIDIA H100 80GB HBM3", "discrete", None),
            device(2, "NVIDIA GeForce RTX 4090 Ti", "discrete", None),
        ];
        assert_eq!(chosen(&all, Some("4090")), Ok(2));
        assert_eq!(chosen(&all, Some("h100")), Ok(1));
        assert_eq!(chosen(&all, Some(" 1 ")), Ok(1));
        for missing in ["3", "5", "6", "15", "10", "80", "409", "", " "] {
            let error = chosen(&all, Some(missing)).unwrap_err();
            assert!(
                error.starts_with(&format!("there is no device `{missing}`; available: 0: llvmpipe")),
                "{error}"
            );
        }
    }

    #[test]
    fn an_unfit_device_is_passed_over_and_refused_by_name_with_the_reason() {
        let all = [device(0, "old", "discrete", Some("it is too old")), device(1, "llvmpipe", "cpu", None)];
        assert_eq!(chosen(&all, None), Ok(1));
        assert!(chosen(&all, Some("old")).unwrap_err().contains("old cannot run plans: it is too old"));
        assert!(chosen(&all[..1], None).unwrap_err().contains("too old"));
        assert!(chosen(&[], None).is_err());
    }
}
