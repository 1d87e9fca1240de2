//! Runs `splatgraph convert`: writes a scene in another format, and says what that loses.

use super::{Outcome, Usage, options};
use crate::io::output::{self, OutputGuard, is_standard_output, note, say};
use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use splatgraph_assets::{Scene, SceneFormat, grouped, sh_floats};
use std::io::{self, Write};
use std::path::PathBuf;

pub const EXAMPLES: &str = "Examples:
  splatgraph convert scene.ply scene.spz
  splatgraph convert scene.spz scene.ply
  splatgraph convert scene.ply scene.compressed.ply --degree 1
  splatgraph convert scene.ply - --format splat > scene.splat";

/// Write a scene in another format, and say what that loses
///
/// The bytes of IN tell its format; that of OUT is told by its extension or by --format. The last lines compare the sizes and list what
/// the format rounds or drops.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scene
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// The file to write; `-` is standard output
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Format of OUT [default: by its extension]
    #[arg(long, value_parser = formats())]
    format: Option<SceneFormat>,
    /// Drop the spherical harmonics above this degree
    #[arg(long, value_name = "0..3", value_parser = clap::value_parser!(u32).range(0..=3))]
    degree: Option<u32>,
}

/// Parses the name of a format, which is its extension.
fn formats() -> impl TypedValueParser<Value = SceneFormat> {
    PossibleValuesParser::new(SceneFormat::WRITTEN.map(SceneFormat::extension)).map(|name| {
        let named = |format: &SceneFormat| format.extension() == name;
        SceneFormat::WRITTEN.into_iter().find(named).expect("the parser takes only these names")
    })
}

/// Lists the formats, for help.
pub fn format_list() -> String {
    let row = |format: SceneFormat| (format!(".{}", format.extension()), format.summary().to_owned());
    format!("Formats:\n{}", options::two_columns(SceneFormat::WRITTEN.map(row).to_vec()))
}

/// Checks the files of the command line, and finds the format of the output.
pub(super) fn check_files(args: &Args) -> Result<SceneFormat, Usage> {
    let mut guard = OutputGuard::default();
    guard.input("the scene", &args.input)?;
    guard.output("the output", &args.output)?;
    if is_standard_output(&args.output) {
        options::refuse_terminal("the scene")?;
    }
    let named = SceneFormat::of_name(&args.output).filter(|format| SceneFormat::WRITTEN.contains(format));
    args.format.or(named).ok_or_else(|| {
        let endings = SceneFormat::WRITTEN.map(|format| format!(".{}", format.extension())).join(", ");
        let found = args.output.display();
        Usage(format!("expected a file name that ends in {endings}, or --format, found {found}"))
    })
}

/// Counts the bytes that are written through it.
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

/// Lists what the output lacks of the input, a phrase per line.
fn losses(loaded: &Scene, written: &Scene, format: SceneFormat) -> Vec<String> {
    let mut losses = Vec::new();
    let dropped = loaded.dropped();
    if dropped.total() > 0 {
        losses.push(format!("{} splats that cannot be drawn: {dropped}", grouped(dropped.total())));
    }
    if let Some(degree) = loaded.notes().cut_degree {
        losses.push(format!("harmonics: cut from degree {degree} to 3, the most that is read"));
    }
    let (from, to) = (loaded.stored_degree(), written.stored_degree());
    if to < from {
        losses.push(format!("harmonics: cut from degree {from} to {to}"));
    }
    if loaded.notes().antialiased && format != SceneFormat::Spz {
        losses.push("the mark that the splats were trained with anti-aliasing".into());
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
    losses.extend(format.losses(to).into_iter().map(str::to_owned));
    losses
}

pub fn run(args: &Args) -> Result<Outcome> {
    let format = check_files(args)?;
    let loaded = options::load_scene(&args.input)?;
    let cut = args.degree.filter(|degree| *degree < loaded.stored_degree());
    let cut = cut.map(|degree| loaded.cut_to_degree(degree)).transpose()?;
    let scene = cut.as_ref().unwrap_or(&loaded);
    let mut bytes = 0;
    output::write(&args.output, |out| {
        let mut counted = Counted { out, bytes: 0 };
        scene.write(format, &mut counted)?;
        bytes = counted.bytes;
        Ok(())
    })?;

    let tell = |line: String| if is_standard_output(&args.output) { say(line) } else { note(line) };
    let before = loaded.size_breakdown();
    let splats = grouped(loaded.count().into());
    let (path, from, size) = (args.input.display(), &before.format, grouped(before.file_bytes));
    tell(format!("{path}: {from}, {splats} splats of degree {}, {size} bytes", loaded.stored_degree()));
    let percent = 100.0 * bytes as f64 / before.file_bytes.max(1) as f64;
    let (path, to) = (args.output.display(), format.extension());
    tell(format!("{path}: {to}, {} bytes, {percent:.1} % of them", grouped(bytes)));
    for loss in losses(&loaded, scene, format) {
        tell(format!("  lost: {loss}"));
    }
    Ok(Outcome::Done)
}
