//! Keeps compiled shaders in a folder, so that the program does not compile them again after a restart.
//!
//! The folder is in the user's cache folder, and can be shared and deleted. Several processes may read and write it at
//! the same time: each file is either complete or absent. A file that is damaged or from another build of the program
//! is ignored and replaced. Each file contains its whole key (texts, defines, build of the program), to detect hash
//! collisions.
//!
//! The linker's build id, a hash of the program's contents, identifies the build: copies of the program share shaders,
//! and a program that differs in one byte does not. Without a build id, its version, commit, size and modification time
//! are used. The version is there because some package managers set the same modification time for all files.

use crate::io::folders;
use crate::io::program::VERSION;
use crate::io::report::text;
use splatgraph_assets::file;
use splatgraph_framework::shader::SpirvStore;
use std::collections::hash_map::DefaultHasher;
use std::ffi::OsStr;
use std::fs;
use std::hash::{Hash, Hasher};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;
#[cfg(unix)]
use std::{fs::Permissions, os::unix::fs::PermissionsExt};

/// Environment variable that disables the cache if set to `off`, `0`, `no` or `false`, in upper or lower case.
pub const VARIABLE: &str = "SPLATGRAPH_SHADER_CACHE";
/// Size of the cache, in bytes, above which the oldest files are deleted before another is written.
const MAX_BYTES: u64 = 64 << 20;
/// Maximum number of bytes that are read from a file.
const MAX_FILE_BYTES: u64 = 16 << 20;
/// Bytes of a program in which its build id is searched. Linkers put it behind the program headers.
const HEAD_BYTES: u64 = 4096;
/// Magic number at the start of a file. It changes with the file's layout.
const MAGIC: &[u8; 8] = b"sgspv001";

/// A folder of compiled shaders.
#[derive(Debug)]
pub struct ShaderCache {
    folder: PathBuf,
    /// Identity of the program's build, which includes the compiler.
    build: Vec<u8>,
}

impl ShaderCache {
    /// Opens the user's cache for the compiler in `program`.
    ///
    /// `None` if there is no cache folder, [`VARIABLE`] disables it, or the program cannot be read.
    pub fn of_user(program: &Path) -> Option<ShaderCache> {
        if std::env::var_os(VARIABLE).is_some_and(|value| is_off(&value)) {
            return None;
        }
        Some(ShaderCache {
            folder: folders::cache()?.join("splatgraph/shaders"),
            build: build(program).ok()?,
        })
    }

    fn path(&self, key: &[u8]) -> PathBuf {
        let mut hasher = DefaultHasher::new();
        (&self.build, key).hash(&mut hasher);
        self.folder.join(text::hex(hasher.finish()) + ".spv")
    }

    /// Returns the bytes before the SPIR-V.
    fn head(&self, key: &[u8]) -> Vec<u8> {
        let lengths = [self.build.len() as u64, key.len() as u64].map(u64::to_le_bytes);
        [&MAGIC[..], &lengths[0], &lengths[1], &self.build, key].concat()
    }

    fn read(&self, key: &[u8]) -> io::Result<Option<Vec<u32>>> {
        let mut bytes = Vec::new();
        file::open(self.path(key))?.take(MAX_FILE_BYTES).read_to_end(&mut bytes)?;
        let words = bytes.strip_prefix(&self.head(key)[..]).and_then(|rest| rest.split_last_chunk::<4>());
        let Some((words, sum)) = words.filter(|(words, _)| words.len() % 4 == 0) else { return Ok(None) };
        if crc32fast::hash(words) != u32::from_le_bytes(*sum) {
            return Ok(None);
        }
        Ok(Some(words.chunks_exact(4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]])).collect()))
    }

    fn write(&self, key: &[u8], spirv: &[u32]) -> io::Result<()> {
        fs::create_dir_all(&self.folder)?;
        self.prune();
        let words: Vec<u8> = spirv.iter().flat_map(|word| word.to_le_bytes()).collect();
        let sum = crc32fast::hash(&words).to_le_bytes();
        #[cfg_attr(not(unix), allow(unused_mut, reason = "other systems have no such permissions"))]
        let mut file = tempfile::Builder::new();
        // The umask applies. By default, other users of a shared folder could not read the file.
        #[cfg(unix)]
        file.permissions(Permissions::from_mode(0o666));
        let mut file = file.tempfile_in(&self.folder)?;
        file.write_all(&[&self.head(key)[..], &words, &sum].concat())?;
        file.persist(self.path(key))?;
        Ok(())
    }

    /// If the total size exceeds [`MAX_BYTES`], removes the oldest files until it is at most half of that.
    fn prune(&self) {
        let mut files: Vec<(SystemTime, u64, PathBuf)> = found(&self.folder);
        let mut bytes: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
        if bytes <= MAX_BYTES {
            return;
        }
        files.sort();
        for (_, length, path) in files {
            if bytes <= MAX_BYTES / 2 {
                break;
            }
            // Another process may have removed the file.
            let _ = fs::remove_file(path);
            bytes -= length;
        }
    }
}

fn is_off(value: &OsStr) -> bool {
    ["off", "0", "no", "false"].iter().any(|off| value.eq_ignore_ascii_case(off))
}

/// Returns the identity of a program's build: its build id or, without one, its version, size and modification time.
fn build(program: &Path) -> io::Result<Vec<u8>> {
    let program = file::open(program)?;
    let mut head = Vec::new();
    (&program).take(HEAD_BYTES).read_to_end(&mut head)?;
    if let Some(id) = build_id(&head) {
        return Ok(id.to_vec());
    }
    let data = program.metadata()?;
    Ok(format!("{VERSION} {} {:?}", data.len(), data.modified()?).into_bytes())
}

/// Finds the GNU build id in the first bytes of an ELF file. It is a note with the name `GNU` and the type 3. `None` if
/// there is none, or if it ends beyond these bytes.
fn build_id(head: &[u8]) -> Option<&[u8]> {
    const NOTE: &[u8] = b"\x03\0\0\0GNU\0";
    let at = head.windows(NOTE.len()).position(|window| window == NOTE)?;
    let length = u32::from_le_bytes(*head[..at].last_chunk()?);
    head.starts_with(b"\x7fELF").then_some(&head[at + NOTE.len()..])?.get(..length as usize)
}

fn found(folder: &Path) -> Vec<(SystemTime, u64, PathBuf)> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let file = |entry: fs::DirEntry| {
        let data = entry.metadata().ok().filter(|data| data.is_file())?;
        Some((data.modified().ok()?, data.len(), entry.path()))
    };
    entries.filter_map(file).collect()
}

impl SpirvStore for ShaderCache {
    fn load(&self, key: &[u8]) -> Option<Vec<u32>> {
        self.read(key).ok().flatten()
    }

    fn store(&self, key: &[u8], spirv: &[u32]) {
        // A failed write only costs a compilation in the next run.
        let _ = self.write(key, spirv);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts;
    use crate::draw::planner::{Planner, Settings};
    use std::sync::Arc;

    fn cache(folder: &Path) -> ShaderCache {
        ShaderCache { folder: folder.join("shaders"), build: b"one".to_vec() }
    }

    #[test]
    fn usual_words_disable_the_cache() {
        assert!(["off", "OFF", "0", "no", "False"].iter().all(|value| is_off(OsStr::new(value))));
        assert!(!["", "on", "1"].iter().any(|value| is_off(OsStr::new(value))));
    }

    #[test]
    fn words_come_back_under_their_key_and_build_alone() {
        let folder = tempfile::tempdir().unwrap();
        let one = cache(folder.path());
        assert_eq!(one.load(b"key"), None);
        one.store(b"key", &[1, 2, 0x0723_0203]);
        assert_eq!(one.load(b"key"), Some(vec![1, 2, 0x0723_0203]));
        assert_eq!(one.load(b"other"), None);
        let other = ShaderCache { build: b"two".to_vec(), ..cache(folder.path()) };
        assert_eq!(other.load(b"key"), None);
        // Simulate a hash collision.
        fs::copy(one.path(b"key"), one.path(b"other")).unwrap();
        assert_eq!(one.load(b"other"), None);
    }

    #[test]
    fn copies_of_a_program_share_shaders_and_programs_that_differ_in_their_build_id_do_not() {
        let folder = tempfile::tempdir().unwrap();
        let identity = |head: &[u8], seconds: u64| {
            let program = folder.path().join("program");
            fs::write(&program, head).unwrap();
            let changed = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(seconds);
            fs::File::options().append(true).open(&program).unwrap().set_modified(changed).unwrap();
            build(&program).unwrap()
        };
        let with = |id: &[u8; 4]| [b"\x7fELF \x04\0\0\0\x04\0\0\0\x03\0\0\0GNU\0", &id[..], b"code"].concat();
        assert_eq!(identity(&with(b"id 1"), 1), b"id 1");
        assert_eq!(identity(&with(b"id 1"), 2), identity(&with(b"id 1"), 1));
        assert_ne!(identity(&with(b"id 2"), 1), identity(&with(b"id 1"), 1));
        // Without a build id, or with one that the file's end cuts off.
        for head in [&b"code"[..], b"\x7fELF\x03\0\0\0GNU\0", b"\x7fELF\x14\0\0\0\x03\0\0\0GNU\0cut"] {
            assert!(identity(head, 1).starts_with(VERSION.as_bytes()), "the commit may be all that differs");
            assert_ne!(identity(head, 1), identity(head, 2));
            assert_ne!(identity(head, 1), identity(&[head, b"more"].concat(), 1));
        }
    }

    #[test]
    #[cfg(unix)]
    fn files_have_the_mode_that_the_umask_leaves() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path());
        cache.store(b"key", &[1]);
        fs::write(folder.path().join("other"), "").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&cache.path(b"key")), mode(&folder.path().join("other")));
    }

    #[test]
    fn a_damaged_file_is_no_shader_whatever_byte_of_it_differs_or_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path());
        cache.store(b"key", &[7, 8, 9]);
        let path = cache.path(b"key");
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            fs::write(&path, &damaged).unwrap();
            assert_eq!(cache.load(b"key"), None, "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(cache.load(b"key"), None, "{at} bytes");
        }
        cache.store(b"key", &[7]);
        assert_eq!(cache.load(b"key"), Some(vec![7]));
    }

    #[test]
    fn the_oldest_shaders_go_when_all_are_too_large() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path());
        let words = vec![0; (MAX_BYTES / 5 / 4) as usize];
        for key in 0..6u8 {
            cache.store(&[key], &words);
            let file = fs::File::options().append(true).open(cache.path(&[key])).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(key.into())).unwrap();
        }
        let left: Vec<u8> = (0..6).filter(|key| cache.load(&[*key]).is_some()).collect();
        assert_eq!(left, [3, 4, 5]);
    }

    #[test]
    fn a_plan_is_the_same_from_a_folder_that_cannot_be_written_an_empty_one_and_a_full_one() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("blocked");
        fs::write(&blocked, "a file").unwrap();
        let facts = facts::nominal(8);
        let plan = |folder: &Path| {
            let settings = Settings { store: Some(Arc::new(cache(folder))), ..Settings::default() };
            let mut planner = Planner::new(settings);
            let plan = planner.plan("splat", &[], &facts, &facts::nominal_catalog());
            (plan.unwrap_or_else(|error| panic!("{error}")), planner.compiled())
        };
        let (expected, compiled) = plan(&blocked);
        assert!(compiled > 0);
        let first = plan(folder.path());
        assert_eq!(first.1, compiled);
        let again = plan(folder.path());
        assert_eq!(again.1, 0, "every shader comes from the folder");
        assert!(expected == first.0 && expected == again.0);
    }
}
