//! Finds photographs, and reads their sizes.

use crate::file;
use crate::words::bytes_at;
use std::io::{BufReader, Error, ErrorKind, Read, Result};
use std::path::{Component, Path, PathBuf};
use zune_jpeg::JpegDecoder;

/// Extensions of photographs. They are tried for a photograph's name: first appended to it, then in place of its own.
pub const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

/// Extensions that are cut off a photograph's name, in lower case. Other endings belong to the name, such as the
/// frame's number in `shot.1001`.
const PICTURES: [&str; 29] = [
    "png", "jpg", "jpeg", "exr", "tif", "tiff", "webp", "bmp", "tga", "gif", "hdr", "dpx", "heic", "avif",
    "jxl", "dng", "cr2", "arw", "nef", "npy", "ppm", "pgm", "pnm", "jp2", "heif", "cr3", "raf", "rw2", "orf",
];

/// Returns the path of a photograph without a leading `./` and a known extension: a camera's `img_name`.
pub(super) fn stem(photograph: &str) -> &str {
    let name = photograph.strip_prefix("./").unwrap_or(photograph);
    let is_picture = |after: &str| PICTURES.iter().any(|known| after.eq_ignore_ascii_case(known));
    match name.rsplit_once('.') {
        Some((stem, after)) if !stem.is_empty() && is_picture(after) => stem,
        _ => name,
    }
}

/// Finds the file of a photograph. Its extension may be missing in `name`, or differ. The name may begin with the name
/// of `folder`: `images/a.png` may be `a.png` in `images`.
///
/// A dataset can come from a stranger, so its names may lead only into `folder` and its parent. The parent is common in
/// a `transforms.json`: `../images/a.png`.
pub(super) fn find(folder: &Path, name: &str) -> Result<PathBuf> {
    let named = folder.join(name);
    if !is_near(folder, Path::new(name)) {
        let help = match Path::new(name).is_absolute() {
            true => "`evaluate --photographs /` accepts it",
            false => "at most one ../ is allowed, also with --photographs",
        };
        let text = format!(
            "expected a photograph in the folder of the dataset's photographs or in the folder around it, found {name}: {help}"
        );
        return Err(Error::new(ErrorKind::InvalidInput, text));
    }
    let find = |name: &str| {
        let added = EXTENSIONS.iter().map(|extension| folder.join(format!("{name}.{extension}")));
        let replaced = EXTENSIONS.iter().map(|extension| folder.join(format!("{}.{extension}", stem(name))));
        [folder.join(name)].into_iter().chain(added).chain(replaced).find(|path| path.is_file())
    };
    let below = || {
        let (first, rest) = name.strip_prefix("./").unwrap_or(name).split_once('/')?;
        find(rest).filter(|_| folder.ends_with(first))
    };
    find(name).or_else(below).ok_or_else(|| {
        let text = format!("expected the photograph {}, found none", named.display());
        Error::new(ErrorKind::NotFound, text)
    })
}

/// Returns true if a name leads into `folder` or its parent.
pub(super) fn is_near(folder: &Path, name: &Path) -> bool {
    let inside = |part: Component| matches!(part, Component::Normal(_));
    if name.is_absolute() {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        // Either path may contain symbolic links that the other avoids, so both are compared resolved and unresolved.
        let real = name.parent().and_then(|parent| Some(parent.canonicalize().ok()?.join(name.file_name()?)));
        let within = |around: &Path| {
            let names = [Some(name), real.as_deref()];
            names
                .into_iter()
                .flatten()
                .any(|name| name.strip_prefix(around).is_ok_and(|rest| rest.components().all(inside)))
        };
        let folders = [std::path::absolute(folder), folder.canonicalize()];
        return folders.iter().flatten().flat_map(|folder| folder.ancestors().take(2)).any(within);
    }
    let mut parts = name.components().filter(|part| *part != Component::CurDir);
    parts.next().is_some_and(|first| first == Component::ParentDir || inside(first)) && parts.all(inside)
}

/// Returns true for a PNG file, and false for a JPEG file, by the first bytes.
///
/// # Errors
/// The file cannot be read, or is in another format, which the error names.
pub fn is_png(path: &Path) -> Result<bool> {
    let mut head = [0; 4];
    file::open(path)?.read_exact(&mut head)?;
    let found = match &head {
        b"\x89PNG" => return Ok(true),
        [0xFF, 0xD8, ..] => return Ok(false),
        b"II*\0" | b"MM\0*" => "a TIFF file".to_owned(),
        b"RIFF" => "a WebP file".to_owned(),
        other => format!("a file that begins with `{}`", other.escape_ascii()),
    };
    Err(wrong(&found))
}

fn wrong(found: &str) -> Error {
    Error::new(ErrorKind::InvalidData, format!("expected a PNG or JPEG photograph, found {found}"))
}

/// Reads width and height in pixels from the header of a PNG or JPEG file.
pub(super) fn size(path: &Path) -> Result<(u32, u32)> {
    /// First bytes of a PNG file: its signature, and its first chunk's length and type. See 5.2 and 11.2.1 of the PNG
    /// specification.
    const PNG: &[u8; 16] = b"\x89PNG\r\n\x1A\n\0\0\0\x0DIHDR";
    if is_png(path)? {
        let mut head = [0; 24];
        file::open(path)?.read_exact(&mut head)?;
        if !head.starts_with(PNG) {
            return Err(wrong("a PNG file without a size"));
        }
        let [width, height] = [16, 20].map(|at| u32::from_be_bytes(bytes_at(&head, at)));
        return Ok((width, height));
    }
    let mut decoder = JpegDecoder::new(BufReader::new(file::open(path)?));
    decoder.decode_headers().map_err(|error| wrong(&error.to_string()))?;
    let size = decoder.dimensions().ok_or_else(|| wrong("a JPEG without a size"))?;
    Ok((size.0 as u32, size.1 as u32))
}
