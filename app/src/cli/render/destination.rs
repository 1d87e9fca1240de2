//! Determines the files to which pictures are written.

use crate::cli::help;
use crate::cli::outcome::Usage;
use crate::draw::outputs::{NAMES, RGBA, check_format};
use crate::io::image::Format;
use crate::io::output::{is_standard_output, names};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// File or folder of the picture.
    Picture(PathBuf),
    /// Name and file of an output besides the picture, such as `depth`.
    Named(String, PathBuf),
}

/// Parses `NAME=FILE`, with a name of letters, digits and `_`, or the path of the picture, such as `./a=b.png`.
pub fn output(text: OsString) -> Result<Output, String> {
    let is_name =
        |name: &str| !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    let Some((name, file)) =
        text.to_str().and_then(|text| text.split_once('=')).filter(|(name, _)| is_name(name))
    else {
        if text.is_empty() {
            return Err("expected a file or a folder, found an empty name".into());
        }
        return Ok(Output::Picture(text.into()));
    };
    let path = Path::new(file);
    // The format in a folder depends on other options.
    let folder = Some(Format::Npy).filter(|_| names::ends_in_separator(path));
    let Some(format) = folder.or_else(|| Format::of(path)) else {
        return Err(format!(
            "expected NAME=FILE with the extension .npy, .exr or .png, or NAME=FOLDER/, found `{name}={file}`"
        ));
    };
    check_format(name, format)?;
    Ok(Output::Named(name.to_owned(), file.into()))
}

pub fn output_help() -> String {
    let names = NAMES.into_iter().chain([RGBA]).map(|(name, what)| (name.to_owned(), what.to_owned()));
    format!("{OUTPUT_HELP}\n\n{}", help::two_columns(names.collect()))
}

const OUTPUT_HELP: &str = "\
Output: .png (8 bits), .exr or .npy (float32, as blended, not clamped), or a folder

A name without one of these extensions is a folder for one picture per camera, named after the camera's img_name, from
which a leading images/ is left out. Characters that a file name cannot have become `_`, and cameras with equal names
get their index appended. `-` writes the picture of one camera to standard output, in the format of --format. Files are
complete, or not written.

NAME=FILE writes another output of the graph; may be repeated. (`./NAME=FILE` is a picture with that name.) With several
cameras, the file's name gets the camera's: depth-CAMERA.npy. NAME=FOLDER/ writes FOLDER/CAMERA.npy, or in the format
of --format if the output can have it. The built-in graphs have these outputs, defined in docs/splatting.md;
quads (`splat`) have only the first three, and `rgba`:";

/// Name of the picture among the files of a camera's statistics.
pub const PICTURE: &str = "picture";

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Destination {
    /// The only picture; `-` is standard output.
    Picture(PathBuf, Format),
    /// One picture per camera.
    Folder(PathBuf, Format),
}

impl Destination {
    /// Determines the destination from `--output` and `--format`; `None` without `--output`. A path with a picture's
    /// extension, a device or a pipe is a picture. Any other path is a folder, as is one that ends in a separator.
    ///
    /// # Errors
    /// The extension contradicts `--format`; or, without `--format`, it is unknown, and no such folder exists.
    pub fn of(output: Option<&Path>, asked: Option<Format>) -> Result<Option<Destination>, Usage> {
        let Some(output) = output else { return Ok(None) };
        if is_standard_output(output) {
            return Ok(Some(Destination::Picture(
                output.to_owned(),
                asked.or(Format::of(output)).unwrap_or(Format::Png),
            )));
        }
        let is_folder = names::ends_in_separator(output);
        if let Some(format) = Format::of(output).filter(|_| !is_folder) {
            if asked.is_some_and(|wanted| wanted != format) {
                return Err(Usage(format!("--format differs from the extension of {}", output.display())));
            }
            return Ok(Some(Destination::Picture(output.to_owned(), format)));
        }
        // A device or a pipe, such as /dev/null.
        if output.metadata().is_ok_and(|found| !found.is_dir() && !found.is_file()) {
            return Ok(Some(Destination::Picture(output.to_owned(), asked.unwrap_or(Format::Png))));
        }
        // A path such as `pictures.jpg` is more likely a mistake than a new folder.
        if let Some(extension) =
            output.extension().filter(|_| !is_folder && !output.is_dir() && asked.is_none())
        {
            return Err(Usage(format!(
                "expected the extension .png, .exr or .npy, found .{} (for a folder of that name, end it with a slash); other \
                 formats need an encoder: `-o - | ffmpeg -i - {}`",
                extension.display(),
                output.display()
            )));
        }
        Ok(Some(Destination::Folder(output.to_owned(), asked.unwrap_or(Format::Png))))
    }

    /// Returns the path of a camera's picture. `stem` is the camera's file name, without extension.
    pub fn path(&self, stem: &str) -> PathBuf {
        match self {
            Destination::Picture(path, _) => path.clone(),
            Destination::Folder(folder, format) => folder.join(format!("{stem}.{format}")),
        }
    }

    pub fn format(&self) -> Format {
        let (Destination::Picture(_, format) | Destination::Folder(_, format)) = self;
        *format
    }
}

pub fn stem(file: &Path) -> std::borrow::Cow<'_, str> {
    file.file_stem().unwrap_or_default().to_string_lossy()
}

/// Returns the format of an output's files in a folder. It is that of `--format` if the output can have it, otherwise
/// .npy, which every output can have.
pub fn in_folder(name: &str, asked: Option<Format>) -> Format {
    asked.filter(|format| check_format(name, *format).is_ok()).unwrap_or(Format::Npy)
}

/// Names the file of a camera's output: `CAMERA.FORMAT` in a folder, `keys-CAMERA.npy` for one of several cameras, or
/// else `file`. `cameras` is the number of cameras.
pub fn per_camera(file: &Path, format: Format, camera: &str, cameras: usize) -> PathBuf {
    if names::ends_in_separator(file) {
        return file.join(format!("{camera}.{format}"));
    }
    if cameras == 1 {
        return file.to_owned();
    }
    let extension = file.extension().unwrap_or_default().display();
    file.with_file_name(format!("{}-{camera}.{extension}", stem(file)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn destination(line: &str) -> Result<Option<Destination>, Usage> {
        let words: Vec<&str> = line.split(' ').collect();
        let after = |option: &str| words.iter().position(|word| *word == option).map(|i| words[i + 1]);
        let format = after("--format").map(|name| name.parse().expect("a format"));
        Destination::of(after("-o").map(Path::new), format)
    }

    #[test]
    fn a_pictures_name_is_a_picture_and_another_name_a_folder() {
        let folder = |format| Some(Destination::Folder("out".into(), format));
        let picture = |name: &str, format| Some(Destination::Picture(name.into(), format));
        assert_eq!(destination("render -o out.EXR").unwrap(), picture("out.EXR", Format::Exr));
        assert_eq!(destination("render -o -").unwrap(), picture("-", Format::Png));
        assert_eq!(destination("render -o - --format exr").unwrap(), picture("-", Format::Exr));
        assert_eq!(destination("render -o out").unwrap(), folder(Format::Png));
        assert_eq!(destination("render -o out --format npy").unwrap(), folder(Format::Npy));
        assert_eq!(
            destination("render -o out.v2 --format exr").unwrap(),
            Some(Destination::Folder("out.v2".into(), Format::Exr))
        );
        for name in ["out.v2/", "out.png/"] {
            assert_eq!(
                destination(&format!("render -o {name}")).unwrap(),
                Some(Destination::Folder(name.into(), Format::Png))
            );
        }
        for (format, line) in [(Format::Png, ""), (Format::Npy, " --format npy")] {
            assert_eq!(
                destination(&format!("render -o /dev/null{line}")).unwrap(),
                picture("/dev/null", format)
            );
        }
        assert_eq!(destination("render --json").unwrap(), None);
        assert!(destination("render -o out.jpg").unwrap_err().to_string().contains("found .jpg"));
        assert!(destination("render -o out.png --format exr").is_err());
    }

    #[test]
    fn an_output_with_a_name_before_its_file_is_not_the_picture() {
        let named = |name: &str, file: &str| Ok(Output::Named(name.into(), file.into()));
        let picture = |path: &str| Ok(Output::Picture(path.into()));
        assert_eq!(output("depth=a/d.exr".into()), named("depth", "a/d.exr"));
        assert_eq!(output("index=a/".into()), named("index", "a/"));
        assert!(output("".into()).unwrap_err().contains("found an empty name"));
        for path in ["out.png", "-", "./a=b.png", "a/b=c"] {
            assert_eq!(output(path.into()), picture(path));
        }
        for (text, why) in
            [("depth=d.png", "end at 1"), ("index=i.png", ".npy"), ("alpha=a", "found `alpha=a`")]
        {
            assert!(output(text.into()).unwrap_err().contains(why), "{text}");
        }
    }

    #[test]
    fn pictures_in_a_folder_are_named_after_their_photographs() {
        let folder = Destination::Folder("out".into(), Format::Exr);
        assert_eq!(folder.path("day 1_0007.jpg"), Path::new("out/day 1_0007.jpg.exr"));
        let file = |path: &str, cameras| per_camera(Path::new(path), Format::Npy, "b.jpg", cameras);
        assert_eq!(file("a/keys.npy", 2), Path::new("a/keys-b.jpg.npy"));
        assert_eq!(file("a/keys.npy", 1), Path::new("a/keys.npy"));
        for cameras in [1, 2] {
            assert_eq!(file("a/", cameras), Path::new("a/b.jpg.npy"));
            assert_eq!(per_camera(Path::new("a/"), Format::Png, "b.jpg", cameras), Path::new("a/b.jpg.png"));
        }
        let png = Some(Format::Png);
        let found = [in_folder(RGBA.0, png), in_folder("depth", png), in_folder(RGBA.0, None)];
        assert_eq!(found, [Format::Png, Format::Npy, Format::Npy]);
    }
}
