//! Lists the machine's GPUs, with their limits and the facts that graphs can use.

use crate::apple::objc;
use crate::features::{self, ReportedLimits};
use metal::{Device, MTLGPUFamily};
use splatgraph_api::{BackendError, DeviceInfo, Heap, Robustness};

pub(crate) struct Physical {
    pub raw: Device,
    pub info: DeviceInfo,
    pub reported: ReportedLimits,
}

pub(crate) fn all() -> Vec<Physical> {
    objc::pool(|| Device::all().into_iter().enumerate().map(|(index, raw)| describe(raw, index)).collect())
}

pub(crate) fn choose(devices: Vec<Physical>, wanted: Option<&str>) -> Result<Physical, BackendError> {
    if devices.is_empty() {
        return Err(BackendError::Unavailable("Metal finds no GPU".to_string()));
    }
    let infos: Vec<&DeviceInfo> = devices.iter().map(|device| &device.info).collect();
    let found = splatgraph_runtime::choose(&infos, wanted)?;
    Ok(devices.into_iter().nth(found).expect("the index was found in this list"))
}

fn describe(raw: Device, index: usize) -> Physical {
    let threads = raw.max_threads_per_threadgroup();
    let reported = ReportedLimits {
        max_buffer_bytes: objc::max_buffer_length(&raw),
        threadgroup_bytes: raw.max_threadgroup_memory_length() as u32,
        max_threads: [threads.width as u32, threads.height as u32, threads.depth as u32],
        working_set: raw.recommended_max_working_set_size(),
        filters_floats: objc::filters_floats(&raw),
    };
    let fit = raw.supports_family(MTLGPUFamily::Apple7);
    let info = DeviceInfo {
        index,
        name: raw.name().to_string(),
        kind: if raw.has_unified_memory() { "integrated" } else { "discrete" }.to_string(),
        driver: format!("Metal, macOS {}", objc::system()),
        facts: features::limits(&reported).facts,
        // Buffer accesses are not checked, and no checks can be requested.
        robustness: Robustness::default(),
        heap: Heap {
            bytes: reported.working_set,
            available: Some(reported.working_set.saturating_sub(objc::allocated_bytes(&raw))),
        },
        unfit: (!fit).then(|| {
            "its family is older than Apple 7, the first family in Macs with Apple silicon".to_string()
        }),
    };
    Physical { raw, info, reported }
}
