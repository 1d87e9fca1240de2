//! Injects faults in tests: the nth step of writing files on a thread fails. Outside of tests, no step fails.

#[cfg(test)]
pub use injected::*;

/// Marks a step of writing a file, which fails only in tests.
#[cfg(not(test))]
#[inline]
pub fn step() -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod injected {
    use std::cell::Cell;
    use std::io;

    thread_local! {
        static LEFT: Cell<Option<u32>> = const { Cell::new(None) };
        static HIDDEN_ONLY: Cell<bool> = const { Cell::new(false) };
    }

    pub fn step() -> io::Result<()> {
        match LEFT.get() {
            Some(0) => Err(io::ErrorKind::StorageFull.into()),
            Some(left) => {
                LEFT.set(Some(left - 1));
                Ok(())
            }
            None => Ok(()),
        }
    }

    #[cfg(target_os = "linux")]
    pub fn hidden_only() -> bool {
        HIDDEN_ONLY.get()
    }

    /// Runs `body` as on a file system without unnamed files.
    pub fn with_hidden_files<T>(body: impl FnOnce() -> T) -> T {
        HIDDEN_ONLY.set(true);
        let result = body();
        HIDDEN_ONLY.set(false);
        result
    }

    /// Runs `body` on a disk that is full after `steps` successful steps.
    pub fn full_after<T>(steps: u32, body: impl FnOnce() -> T) -> T {
        LEFT.set(Some(steps));
        let result = body();
        LEFT.set(None);
        result
    }

    /// Runs `save` once per step, with this step failing, with and without an old file. Returns the number of steps.
    ///
    /// Checks that the old file stays and that no other file is left.
    pub fn at_every_step<E: std::fmt::Display>(
        path: &std::path::Path,
        save: impl Fn(&std::path::Path) -> Result<(), E>,
    ) -> u32 {
        let folder = path.parent().expect("a path in a folder");
        let alone = |old: Option<&[u8]>, step: u32| {
            let names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
            match old {
                Some(old) => {
                    assert_eq!(std::fs::read(path).unwrap(), old, "step {step}: the old file is damaged");
                    assert_eq!(names, [path], "step {step}");
                }
                None => assert_eq!(names, [] as [std::path::PathBuf; 0], "step {step}"),
            }
        };
        let old: &[u8] = b"the old file";
        let mut step = 0;
        loop {
            let _ = std::fs::remove_file(path);
            let new = full_after(step, || save(path));
            if let Err(error) = &new {
                let error = error.to_string();
                assert!(error.contains(&path.display().to_string()), "step {step}: {error}");
                alone(None, step);
            }
            std::fs::write(path, old).unwrap();
            let over = full_after(step, || save(path));
            match over {
                Err(_) => alone(Some(old), step),
                Ok(()) if new.is_ok() => return step,
                Ok(()) => panic!("step {step}: replacing a file has fewer steps"),
            }
            step += 1;
        }
    }
}
