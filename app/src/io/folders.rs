//! Finds the user's folders, by the XDG Base Directory Specification and its counterparts on other systems.

use std::env;
use std::path::PathBuf;

/// Returns the user's cache folder, for files that can be regenerated; `None` if the user has none.
pub fn cache() -> Option<PathBuf> {
    Kind::Cache.folder(variable, env::home_dir)
}

/// Returns the user's state folder, for files that persist across restarts; `None` if the user has none.
#[cfg(feature = "window")]
pub fn state() -> Option<PathBuf> {
    Kind::State.folder(variable, env::home_dir)
}

fn variable(name: &str) -> Option<PathBuf> {
    env::var_os(name).map(PathBuf::from)
}

#[derive(Clone, Copy)]
enum Kind {
    Cache,
    #[cfg_attr(not(feature = "window"), allow(dead_code, reason = "the window alone keeps state"))]
    State,
}

impl Kind {
    fn folder(
        self,
        variable: impl Fn(&str) -> Option<PathBuf>,
        listed_home: impl Fn() -> Option<PathBuf>,
    ) -> Option<PathBuf> {
        // The specification requires relative paths to be ignored.
        let variable = |name| variable(name).filter(|path| path.is_absolute());
        // If HOME is not set, the user database names the home folder.
        let home = || variable("HOME").or_else(&listed_home).filter(|path| path.is_absolute());
        if cfg!(windows) {
            return variable("LOCALAPPDATA");
        }
        let (own, mac, other) = match self {
            Kind::Cache => ("XDG_CACHE_HOME", "Library/Caches", ".cache"),
            Kind::State => ("XDG_STATE_HOME", "Library/Application Support", ".local/state"),
        };
        if cfg!(target_os = "macos") {
            home().map(|home| home.join(mac))
        } else {
            variable(own).or_else(|| home().map(|home| home.join(other)))
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn without_a_home_there_is_no_folder_that_others_can_foresee() {
        let with = |kind: Kind, set: &'static [(&str, &str)], home: Option<&'static str>| {
            let variable = |name: &str| set.iter().find(|(n, _)| *n == name).map(|(_, value)| value.into());
            kind.folder(variable, || home.map(PathBuf::from))
        };
        assert_eq!(
            with(Kind::Cache, &[("XDG_CACHE_HOME", "/cache"), ("HOME", "/me")], None),
            Some("/cache".into())
        );
        assert_eq!(
            with(Kind::Cache, &[("XDG_CACHE_HOME", "cache"), ("HOME", "/me")], None),
            Some("/me/.cache".into())
        );
        assert_eq!(with(Kind::Cache, &[("HOME", "")], Some("/listed")), Some("/listed/.cache".into()));
        assert_eq!(with(Kind::Cache, &[("HOME", "."), ("TMPDIR", "/tmp")], None), None);
        assert_eq!(with(Kind::Cache, &[], Some("")), None);
        assert_eq!(with(Kind::State, &[("HOME", "/me")], None), Some("/me/.local/state".into()));
    }
}
