//! Determines how much memory this process can still allocate. Scenes that cannot fit are refused before they are read.
//!
//! On Linux, three limits apply at once: the system's available memory and free swap, the limit of the control group (a
//! container's), and the process's address-space limit (`ulimit -v`). On other systems the available memory is unknown,
//! and a failed allocation is reported instead.

use std::path::Path;

/// The error of a scene that does not fit in the host's memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a scene that fits in memory, found {count} splats of degree {degree}, which need {}{}: use fewer splats or a \
     lower degree of spherical harmonics, or free memory",
    display(*.needed), available_text(.available)
)]
pub struct SceneMemoryError {
    /// Number of splats.
    pub count: u64,
    /// Degree of the stored spherical harmonics.
    pub degree: u32,
    /// Bytes that the scene needs.
    pub needed: u64,
    /// Bytes that the process can still allocate, if known.
    pub available: Option<u64>,
}

impl SceneMemoryError {
    /// Refuses a scene that needs more than `available` bytes. Accepts every scene if that is unknown. `count` and
    /// `degree` are only for the error.
    ///
    /// # Errors
    /// `needed` exceeds `available`.
    pub fn check_against(count: u64, degree: u32, needed: u64, available: Option<u64>) -> Result<(), Self> {
        match available {
            Some(available) if needed > available => {
                Err(Self { count, degree, needed, available: Some(available) })
            }
            _ => Ok(()),
        }
    }
}

fn available_text(available: &Option<u64>) -> String {
    available.map(|bytes| format!(", of {} available", display(bytes))).unwrap_or_default()
}

/// Formats a byte count with a binary unit: `236.0 MiB`; below 1 KiB, as `512 bytes`.
pub fn display(bytes: u64) -> String {
    let units = [("GiB", 30), ("MiB", 20), ("KiB", 10)];
    match units.iter().find(|(_, shift)| bytes >> shift > 0) {
        Some((unit, shift)) => format!("{:.1} {unit}", bytes as f64 / (1u64 << shift) as f64),
        None => format!("{bytes} bytes"),
    }
}

/// Returns the bytes that this process can still allocate; `None` if unknown.
pub fn available() -> Option<u64> {
    if cfg!(target_os = "linux") { under(Path::new("/")) } else { None }
}

/// Returns the memory that the tightest limit leaves, in bytes; `None` if no limit is known. The limits are read from
/// the folders `proc` and `sys/fs/cgroup` under `root`.
fn under(root: &Path) -> Option<u64> {
    let text = |path: &str| std::fs::read_to_string(root.join(path)).ok();
    let system = text("proc/meminfo").and_then(|info| of_system(&info));
    let address = text("proc/self/limits")
        .zip(text("proc/self/statm"))
        .and_then(|(limits, statm)| of_address_space(&limits, &statm));
    let group = text("proc/self/cgroup").and_then(|groups| of_control_group(root, &groups));
    [system, address, group].into_iter().flatten().min()
}

/// Computes the memory that the system can provide: the available memory and the free swap. `None` if `meminfo` lacks
/// the available memory.
fn of_system(meminfo: &str) -> Option<u64> {
    let field = |name: &str| {
        let line = meminfo.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
    };
    Some(field("MemAvailable:")?.saturating_add(field("SwapFree:").unwrap_or(0)))
}

/// Computes the unused part of the address-space limit; `None` without a limit.
fn of_address_space(limits: &str, statm: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    let limit: u64 = line.split_ascii_whitespace().next()?.parse().ok()?;
    // Assumes the smallest page size. With larger pages this subtracts too little, and the allocation may fail.
    let used = statm.split_ascii_whitespace().next()?.parse::<u64>().ok()?.checked_mul(4096)?;
    Some(limit.saturating_sub(used))
}

/// Computes the unused memory of the control group: the minimum over it and its ancestors. `None` if none has a limit.
fn of_control_group(root: &Path, groups: &str) -> Option<u64> {
    let mut least: Option<u64> = None;
    for line in groups.lines() {
        // `0::/path` in version 2, `9:memory:/path` in version 1.
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (fields.next(), fields.next()) else { continue };
        let version2 = controllers.is_empty();
        if !version2 && !controllers.split(',').any(|controller| controller == "memory") {
            continue;
        }
        let (mount, limit, used, cached) = if version2 {
            ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file")
        } else {
            ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        };
        let mount = root.join(mount);
        // In a container the path may be the host's, which does not exist there. The last ancestor is the mount
        // itself, which is the container's group.
        for folder in Path::new(path.trim_start_matches('/')).ancestors() {
            let folder = mount.join(folder);
            let text = |name: &str| std::fs::read_to_string(folder.join(name)).ok();
            let number = |name: &str| text(name)?.trim().parse::<u64>().ok();
            let (Some(limit), Some(used)) = (number(limit), number(used)) else { continue };
            // The group's inactive page cache counts as used, but can be evicted.
            let cache = text("memory.stat").and_then(|stat| {
                let line = stat.lines().find_map(|line| line.strip_prefix(cached)?.strip_prefix(' '));
                line?.trim().parse::<u64>().ok()
            });
            let left = limit.saturating_sub(used.saturating_sub(cache.unwrap_or(0)));
            least = Some(least.map_or(left, |least| least.min(left)));
        }
    }
    least
}

/// Allocates a column of `count` zeros; `None` if there is not enough memory.
///
/// The system provides a zero page when a thread first touches it. Here each thread first touches the pages that it
/// fills; `try_reserve` followed by `resize` would touch all pages on one thread.
pub(crate) fn zeroed<T: bytemuck::Zeroable>(count: usize) -> Option<Vec<T>> {
    let mut column = bytemuck::try_zeroed_slice_box::<T>(count).ok()?;
    use_large_pages(&mut column);
    Some(column.into())
}

/// Smallest allocation for which large pages are requested, in bytes.
#[cfg(target_os = "linux")]
const LARGE: usize = 8 << 20;

/// Asks the system to back fresh memory with huge pages, which cause fewer page faults.
#[cfg(target_os = "linux")]
fn use_large_pages<T>(column: &mut [T]) {
    const PAGE: usize = 2 << 20;
    let (start, bytes) = (column.as_mut_ptr().cast::<u8>(), size_of_val(column));
    let skipped = start.align_offset(PAGE);
    if bytes >= LARGE && skipped < bytes {
        // SAFETY: the range lies within an allocation, and the advice changes no contents. A system without large pages
        // returns an error, which is ignored.
        unsafe {
            libc::madvise(start.add(skipped).cast(), (bytes - skipped) / PAGE * PAGE, libc::MADV_HUGEPAGE)
        };
    }
}

#[cfg(not(target_os = "linux"))]
fn use_large_pages<T>(_: &mut [T]) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_written_in_binary_units() {
        assert_eq!(display(236 << 20), "236.0 MiB");
        assert_eq!(display(3 << 29), "1.5 GiB");
        assert_eq!(display(1023), "1023 bytes");
    }

    #[test]
    fn the_tightest_of_all_limits_counts() {
        let root = tempfile::tempdir().unwrap();
        let put = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        let available = || under(root.path());
        assert_eq!(available(), None);
        put("proc/meminfo", "MemTotal: 900 kB\nMemAvailable:     500 kB\nSwapFree:  12 kB\n");
        assert_eq!(available(), Some(512 << 10));
        put("proc/self/statm", "20 5 1 1 0 9 0\n");
        put(
            "proc/self/limits",
            "Limit   Soft Limit  Hard Limit  Units\nMax address space unlimited unlimited bytes\n",
        );
        assert_eq!(available(), Some(512 << 10));
        put("proc/self/limits", "Max address space         491520       unlimited            bytes     \n");
        assert_eq!(available(), Some(491_520 - 20 * 4096));
        // Version 2: the group has no limit, its parent has, and half of the used memory can be evicted.
        put("proc/self/cgroup", "0::/outer/inner\n");
        put("sys/fs/cgroup/outer/inner/memory.max", "max\n");
        put("sys/fs/cgroup/outer/inner/memory.current", "90000\n");
        put("sys/fs/cgroup/outer/memory.max", "100000\n");
        put("sys/fs/cgroup/outer/memory.current", "90000\n");
        put("sys/fs/cgroup/outer/memory.stat", "anon 1\ninactive_file 45000\n");
        assert_eq!(available(), Some(55_000));
        // Version 1, in a container that cannot see its path.
        put("proc/self/cgroup", "3:cpu:/x\n2:memory:/docker/abc\n");
        put("sys/fs/cgroup/memory/memory.limit_in_bytes", "70000\n");
        put("sys/fs/cgroup/memory/memory.usage_in_bytes", "69000\n");
        assert_eq!(available(), Some(1000));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_system_says_what_is_available() {
        assert!(available().is_some_and(|bytes| bytes > 1 << 20));
    }

    #[test]
    fn an_allocation_that_fails_is_no_abort() {
        assert_eq!(zeroed::<u32>(3), Some(vec![0; 3]));
        assert_eq!(zeroed::<u32>(0), Some(Vec::new()));
        assert!(zeroed::<[f32; 4]>(usize::MAX / 16).is_none());
    }
}
