//! Finds the pictures to compare, and pairs those of two folders.

use crate::io::image::{Format, is_jpeg, npz_names, split_member};
use crate::io::output::say;
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Two pictures to compare.
pub struct Pair {
    /// Path of `a`; for folders, its name without extension; for archives, the array's name.
    pub name: String,
    pub a: PathBuf,
    pub b: PathBuf,
}

/// The name and the file of a picture.
pub type Named = (String, PathBuf);

/// The pictures that argument A or B of the command names.
pub enum Pictures {
    One(PathBuf),
    /// Pictures of a folder by name without extension (see [`add`]), or arrays of an archive by name.
    Many(BTreeMap<String, PathBuf>),
}

impl Pictures {
    /// Lists the pictures of a folder or an archive; any other path is a single picture.
    ///
    /// # Errors
    /// There is no such file, the folder or the archive cannot be read, or two pictures have the same name without
    /// extension.
    pub fn of(path: &Path) -> Result<Pictures> {
        if split_member(path).is_some() {
            return Ok(Pictures::One(path.to_owned()));
        }
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) {
            let named = npz_names(path)?.into_iter().map(|name| {
                let member = PathBuf::from(format!("{}#{name}", path.display()));
                (name, member)
            });
            return Ok(Pictures::Many(named.collect()));
        }
        if !std::fs::metadata(path).with_context(|| path.display().to_string())?.is_dir() {
            return Ok(Pictures::One(path.to_owned()));
        }
        let mut pictures = BTreeMap::new();
        add(path, "", &mut pictures)?;
        Ok(Pictures::Many(pictures))
    }
}

/// Adds the pictures of a folder or, if it has none, of the folders in it, as in the photographs of a rig. Names begin
/// with `before`. An `_` joins the names of folder and picture, as in the names of drawn pictures.
fn add(folder: &Path, before: &str, pictures: &mut BTreeMap<String, PathBuf>) -> Result<()> {
    let unreadable = || format!("{}: cannot be read", folder.display());
    let (mut folders, mut has_pictures) = (Vec::new(), false);
    for entry in std::fs::read_dir(folder).with_context(unreadable)? {
        let entry = entry.with_context(unreadable)?;
        let file = entry.path();
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let Some(own) = (if is_folder { file.file_name() } else { file.file_stem() }) else { continue };
        // Names that are not UTF-8 must stay distinct.
        let escaped = || own.as_encoded_bytes().escape_ascii().to_string();
        let name = before.to_owned() + &own.to_str().map_or_else(escaped, str::to_owned);
        if is_folder {
            folders.push((file, name + "_"));
        } else if Format::of(&file).is_some() || is_jpeg(&file) {
            // The folder may hold other files, such as statistics.
            has_pictures = true;
            if let Some(other) = pictures.insert(name, file.clone()) {
                bail!("{} and {} have the same name without extension", other.display(), file.display());
            }
        }
    }
    folders.into_iter().filter(|_| !has_pictures).try_for_each(|(folder, name)| add(&folder, &name, pictures))
}

/// Pairs the pictures of two folders or archives, by name or by the number at its end. Pictures without a number are
/// then skipped and listed. Also returns the names and files of pictures without a partner.
///
/// # Errors
/// No picture has a partner, or two pictures of a folder have the same number.
pub fn pairs(
    by_number: bool,
    a: BTreeMap<String, PathBuf>,
    b: BTreeMap<String, PathBuf>,
) -> Result<(Vec<Pair>, Vec<Named>)> {
    let (a, mut b) = if by_number { (numbered(a)?, numbered(b)?) } else { (plain(a), plain(b)) };
    let mut pairs = Vec::new();
    let mut alone = Vec::new();
    for (key, (name, a_path)) in a {
        match b.remove(&key) {
            Some((_, b_path)) => pairs.push(Pair { name, a: a_path, b: b_path }),
            None => alone.push((name, a_path)),
        }
    }
    alone.extend(b.into_values());
    if !pairs.is_empty() || alone.is_empty() {
        return Ok((pairs, alone));
    }
    let list: Vec<String> = alone.iter().map(|(_, path)| format!("\n  {}", path.display())).collect();
    let hint = match by_number {
        true => "",
        false => "\nno two names match; --by-number matches by the number at the end",
    };
    bail!("these pictures have no partner:{}{hint}", list.concat());
}

/// Names and files of one side, by the key that pairs them with the other side.
type Keyed = BTreeMap<(u64, String), Named>;

fn plain(pictures: BTreeMap<String, PathBuf>) -> Keyed {
    pictures.into_iter().map(|(stem, path)| ((0, stem.clone()), (stem, path))).collect()
}

fn numbered(pictures: BTreeMap<String, PathBuf>) -> Result<Keyed> {
    let mut keyed = Keyed::new();
    for (stem, path) in pictures {
        let digits = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        match stem[digits..].parse::<u64>() {
            Ok(number) => {
                if let Some((_, other)) = keyed.insert((number, String::new()), (stem, path.clone())) {
                    bail!("{} and {} end in the same number", other.display(), path.display());
                }
            }
            Err(_) => say(format!("skipped: {} (its name does not end in a number)", path.display())),
        }
    }
    Ok(keyed)
}
