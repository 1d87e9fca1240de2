//! Runs `splatgraph convert`: writes a scene in another format, and lists what is lost.

mod edit;
mod price;

use super::options;
use super::outcome::{Outcome, Usage};
use crate::io::output::{self, OutputGuard, is_standard_output, note, say};
use crate::io::progress::Progress;
use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use edit::EditArgs;
use price::PriceArgs;
use splatgraph_assets::{Dropped, FileNotes, Scene, SceneFormat, SortKey, SpzVersion, grouped, sh_floats};
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

pub const EXAMPLES: &str = "Examples:
  splatgraph convert scene.ply scene.spz
  splatgraph convert scene.spz scene.ply
  splatgraph convert scene.ply scene.compressed.ply --degree 1
  splatgraph convert scene.ply - --format splat > scene.splat
  splatgraph convert scene.ply part.spz --crop sphere:0,0,0,2 --where 'opacity > 0.05'
  splatgraph convert scene.ply --price -c cameras.json
  splatgraph convert a.ply both.ply --merge b.ply --transform rotate:1,0,0,180";

/// Write a scene in another format, and list what is lost
///
/// The contents of IN determine its format. The format of OUT follows from its extension or from --format. The last lines compare
/// the sizes and list what the format rounds or drops.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scene
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// The file to write; `-` is standard output
    #[arg(value_name = "OUT", required_unless_present = "price")]
    output: Option<PathBuf>,
    /// Format of OUT [default: by its extension]
    #[arg(long, value_parser = formats())]
    format: Option<SceneFormat>,
    /// Drop the spherical harmonics above this degree
    #[arg(long, value_name = "0..3", value_parser = clap::value_parser!(u32).range(0..=3))]
    degree: Option<u32>,
    /// Version of SPZ [default: 4]
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u8).range(3..=4))]
    spz_version: Option<u8>,
    #[command(flatten)]
    edit: EditArgs,
    #[command(flatten)]
    price: PriceArgs,
}

/// Makes the parser for the name of a format, which is its extension.
fn formats() -> impl TypedValueParser<Value = SceneFormat> {
    PossibleValuesParser::new(SceneFormat::WRITTEN.map(SceneFormat::extension)).map(|name| {
        let named = |format: &SceneFormat| format.extension() == name;
        SceneFormat::WRITTEN.into_iter().find(named).expect("the parser takes only these names")
    })
}

/// Lists the formats, for the help text.
pub fn format_list() -> String {
    let row = |format: SceneFormat| (format!(".{}", format.extension()), format.summary().to_owned());
    format!("Formats:\n{}", super::help::two_columns(SceneFormat::WRITTEN.map(row).to_vec()))
}

/// Checks the files of the command line. Returns the output and its format; `None` without an output.
pub(super) fn check_files(args: &Args) -> Result<Option<(&Path, SceneFormat)>, Usage> {
    let mut guard = OutputGuard::default();
    guard.input("the scene", &args.input)?;
    for path in &args.edit.merge {
        guard.input("a scene of --merge", path)?;
    }
    args.price.claim(&mut guard, &args.input)?;
    let Some(output) = args.output.as_deref() else { return Ok(None) };
    guard.output("the output", output)?;
    if is_standard_output(output) {
        options::refuse_terminal("the scene")?;
    }
    let named = SceneFormat::of_name(output).filter(|format| SceneFormat::WRITTEN.contains(format));
    let format = args.format.or(named);
    if args.spz_version.is_some() && format.is_some_and(|format| format != SceneFormat::Spz) {
        return Err(Usage("--spz-version is for .spz".into()));
    }
    format.map(|format| Some((output, format))).ok_or_else(|| {
        let endings = SceneFormat::WRITTEN.map(|format| format!(".{}", format.extension())).join(", ");
        let found = output.display();
        Usage(format!("expected a file name that ends in {endings}, or --format, found {found}"))
    })
}

/// A writer that counts its bytes.
struct Counted<'a> {
    out: &'a mut dyn Write,
    bytes: u64,
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Properties of the input that the report compares with the output.
struct Before {
    format: String,
    file_bytes: u64,
    count: u64,
    degree: u32,
    dropped: Dropped,
    notes: FileNotes,
}

impl Before {
    fn of(scene: &Scene) -> Before {
        let breakdown = scene.size_breakdown();
        Before {
            format: breakdown.format.clone(),
            file_bytes: breakdown.file_bytes,
            count: scene.count().into(),
            degree: scene.stored_degree(),
            dropped: *scene.dropped(),
            notes: scene.notes(),
        }
    }
}

/// Lists what the output lacks compared with the input, one phrase per line.
fn losses(loaded: &Before, written: &Scene, format: SceneFormat) -> Vec<String> {
    let mut losses = Vec::new();
    let dropped = &loaded.dropped;
    if dropped.total() > 0 {
        losses.push(format!("{} splats that cannot be drawn: {dropped}", grouped(dropped.total())));
    }
    if let Some(degree) = loaded.notes.cut_degree {
        losses.push(format!("harmonics: cut from degree {degree} to 3, the most that is read"));
    }
    losses.extend(loaded.notes.left_out());
    let (from, to) = (loaded.degree, written.stored_degree());
    if to < from {
        losses.push(format!("harmonics: cut from degree {from} to {to}"));
    }
    for (tag, value) in written.notes().tags() {
        if !format.keeps_tag(tag) {
            losses.push(format!("the tag {tag} {value}"));
        }
    }
    if format == SceneFormat::Gltf && written.notes().key_of == SortKey::Depth {
        losses.push("the order by depth: the format has the distance from the camera alone".into());
    }
    let largest = match format {
        SceneFormat::Spz => 1.0,
        SceneFormat::CompressedPly => 4.0,
        _ => f32::INFINITY,
    };
    let above = written.sh().chunks_exact(sh_floats(to)).flat_map(|sh| &sh[3..]);
    let clipped = above.filter(|value| value.abs() > largest).count() as u64;
    if clipped > 0 {
        losses.push(format!("harmonics: {} coefficients beyond {largest} are clipped", grouped(clipped)));
    }
    if let Some(mesh) = written.mesh() {
        losses.push(format!("the mesh: {} triangles", grouped(mesh.triangles.len() as u64)));
    }
    losses.extend(format.losses(to).into_iter().map(str::to_owned));
    losses
}

pub fn run(args: &Args) -> Result<Outcome> {
    let output = check_files(args)?;
    let loaded = options::load_scene(&args.input)?;
    let before = Before::of(&loaded);
    let edited = args.edit.apply(loaded)?;
    let cut = args.degree.filter(|degree| *degree < edited.stored_degree());
    let cut = cut.map(|degree| edited.cut_to_degree(degree)).transpose()?;
    let scene = cut.as_ref().unwrap_or(&edited);
    let Some((output, format)) = output else { return args.price.run(scene, &args.input) };
    let mut bytes = 0;
    let progress = Mutex::new(Progress::new(format!("writing {}", output.display())));
    let tell = |done, of| {
        if let Ok(mut progress) = progress.lock() {
            progress.set(done, of, "");
        }
        ControlFlow::Continue(())
    };
    output::write(output, |out| {
        let mut counted = Counted { out, bytes: 0 };
        match args.spz_version {
            Some(3) => scene.write_spz(SpzVersion::V3, &mut counted)?,
            _ => scene.write(format, &tell, &mut counted)?,
        }
        bytes = counted.bytes;
        Ok(())
    })?;
    drop(progress);

    let tell = |line: String| if is_standard_output(output) { say(line) } else { note(line) };
    let (path, from, size) = (args.input.display(), &before.format, grouped(before.file_bytes));
    tell(format!(
        "{path}: {from}, {} splats of degree {}, {size} bytes",
        grouped(before.count),
        before.degree
    ));
    let percent = 100.0 * bytes as f64 / before.file_bytes.max(1) as f64;
    let (path, to) = (output.display(), format.extension());
    let count = u64::from(scene.count());
    let splats = if count == before.count { String::new() } else { format!("{} splats, ", grouped(count)) };
    tell(format!("{path}: {to}, {splats}{} bytes, {percent:.1} % of them", grouped(bytes)));
    for loss in losses(&before, scene, format) {
        tell(format!("  lost: {loss}"));
    }
    Ok(Outcome::Done)
}
