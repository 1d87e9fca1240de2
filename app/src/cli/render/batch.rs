//! Draws one picture per camera without stalling on file output.
//!
//! Frames of the next cameras are in flight while pictures are read back, and [`Pictures`] encodes and writes them on
//! other threads.

use super::destination::{Destination, PICTURE, per_camera};
use super::kept::Kept;
use crate::cli::options::text_of;
use crate::cli::stdout::Stdout;
use crate::draw::outputs::{self, Output, RGBA};
use crate::draw::pictures::{self, Pictures};
use crate::draw::session::{FrameOptions, Session, SessionError, image_of};
use crate::draw::stats::{CameraStats, Opened};
use crate::io::image::Format;
use crate::io::output::{one_line, say};
use crate::io::progress::Progress;
use anyhow::{Context, Result, bail};
use splatgraph_api::{Device, FRAMES_IN_FLIGHT, FrameId, Pixels};
use splatgraph_assets::Camera;
use std::collections::{HashMap, VecDeque};
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use tracing::info_span;

/// Cameras whose frames are in flight or whose pictures are being written, and the statistics of finished cameras.
pub struct Batch {
    /// File or folder of the pictures; `None` if no picture is written.
    pub destination: Option<Destination>,
    /// The outputs besides the picture, each with its name, its file or folder, and its format in a folder; and the
    /// number of cameras.
    files: (Vec<(String, PathBuf, Format)>, usize),
    background: [f32; 3],
    stdout: Stdout,
    /// Options of the device, to record them.
    pub opened: Opened,
    flying: VecDeque<Flying>,
    pictures: Pictures<Told>,
    /// Channel that ends once no picture has its pixels in the device's memory: each of these holds a clone of the
    /// sender.
    pixels: (Sender<Infallible>, Receiver<Infallible>),
    /// Statistics of the finished cameras. `None` if they are not written, because thousands take hundreds of
    /// megabytes.
    done: Option<Vec<CameraStats>>,
    /// Number of cameras that saw no splat.
    pub blind: usize,
    /// Cameras that are not drawn, by error.
    skipped: Vec<(SessionError, Vec<String>)>,
    /// Sizes for which no plan can be loaded, each with the index of its error in `skipped`.
    refused: HashMap<(u32, u32), usize>,
}

struct Flying {
    frame: FrameId,
    name: String,
    stem: String,
    size: (u32, u32),
}

/// A camera whose files are written, with the line to print.
struct Told {
    stats: CameraStats,
    line: String,
    /// Warnings about pixels that the formats of the files cannot hold.
    notes: Vec<String>,
}

impl Batch {
    /// Creates a batch with at most `jobs` unfinished pictures. It keeps the cameras' statistics if `keeps_stats`.
    pub fn new(
        (jobs, keeps_stats): (usize, bool),
        destination: Option<Destination>,
        files: (Vec<(String, PathBuf, Format)>, usize),
        background: [f32; 3],
        stdout: Stdout,
    ) -> Batch {
        Batch {
            destination,
            files,
            background,
            stdout,
            opened: Opened::default(),
            flying: VecDeque::new(),
            pictures: Pictures::new(jobs),
            pixels: channel(),
            done: keeps_stats.then(Vec::new),
            blind: 0,
            skipped: Vec::new(),
            refused: HashMap::new(),
        }
    }

    /// Returns true if the picture is read back: for its own file, or for the output [`RGBA`].
    pub fn reads_picture(&self) -> bool {
        self.destination.is_some() || self.files.0.iter().any(|(name, ..)| name == RGBA.0)
    }

    /// Submits the only frame of a camera. The session must be prepared for the camera's size. If [`FRAMES_IN_FLIGHT`]
    /// frames are in flight, first waits for the oldest.
    ///
    /// # Errors
    /// The device fails, or an earlier picture cannot be written.
    pub fn submit(
        &mut self,
        session: &mut Session,
        (camera, stem): (&Camera, &str),
        progress: &Progress,
    ) -> Result<()> {
        if self.flying.len() == FRAMES_IN_FLIGHT {
            self.land(session, progress)?;
        }
        let (background, read_output) = (self.background, self.reads_picture());
        let inspect = session.plan().map(outputs::inspections).unwrap_or_default();
        let options = FrameOptions { background, read_output, inspect, ..FrameOptions::default() };
        let frame = session.submit(camera, &options)?;
        let size = (camera.width, camera.height);
        self.flying.push_back(Flying { frame, name: camera.img_name.clone(), stem: stem.to_owned(), size });
        Ok(())
    }

    /// Records that no plan can be loaded for a camera, and thus for any other of its size.
    ///
    /// # Errors
    /// The error concerns the device, and thus all cameras.
    pub fn refuse(&mut self, camera: &Camera, error: SessionError) -> Result<()> {
        let index = self.skip(camera.img_name.clone(), error)?;
        self.refused.insert((camera.width, camera.height), index);
        Ok(())
    }

    /// Skips a camera whose size was refused; returns false for others. Another attempt could compile all pipelines and
    /// upload the scene again.
    pub fn skip_refused(&mut self, camera: &Camera) -> bool {
        let Some(index) = self.refused.get(&(camera.width, camera.height)) else { return false };
        self.skipped[*index].1.push(camera.img_name.clone());
        true
    }

    /// Records that a camera is not drawn, and returns the index of the error in `skipped`.
    ///
    /// # Errors
    /// The error concerns the device, and thus all cameras.
    pub fn skip(&mut self, camera: String, error: SessionError) -> Result<usize> {
        if !error.spares_device() {
            return Err(error.into());
        }
        let text = error.to_string();
        let same = self.skipped.iter().position(|(other, _)| other.to_string() == text);
        let index = same.unwrap_or(self.skipped.len());
        match self.skipped.get_mut(index) {
            Some((_, cameras)) => cameras.push(camera),
            None => self.skipped.push((error, vec![camera])),
        }
        Ok(index)
    }

    /// Fails if cameras were skipped, and clears the list of them. `all` is the number of cameras.
    ///
    /// # Errors
    /// The reason for the skips if all cameras were skipped for the same one, otherwise a list of cameras and reasons.
    pub fn report_skipped(&mut self, all: usize) -> Result<()> {
        self.refused.clear();
        let mut skipped = std::mem::take(&mut self.skipped);
        let count: usize = skipped.iter().map(|(_, cameras)| cameras.len()).sum();
        if count == 0 {
            return Ok(());
        }
        if count == all && skipped.len() == 1 {
            return Err(skipped.remove(0).0.into());
        }
        let line = |(error, cameras): &(SessionError, Vec<String>)| {
            format!("\n{}: {}", one_line(&cameras.join(", ")), error.to_string().trim_end())
        };
        let lines: String = skipped.iter().map(line).collect();
        bail!("{count} of {all} cameras are not drawn:{lines}")
    }

    /// Waits for all frames in flight, before another plan is prepared.
    ///
    /// # Errors
    /// See [`Batch::submit`].
    pub fn land_all(&mut self, session: &mut Session, progress: &Progress) -> Result<()> {
        while !self.flying.is_empty() {
            self.land(session, progress)?;
        }
        Ok(())
    }

    /// Waits for the oldest frame in flight. Starts to write its picture, or skips its camera if the frame failed.
    fn land(&mut self, session: &mut Session, progress: &Progress) -> Result<()> {
        let Some(Flying { frame, name, stem, size }) = self.flying.pop_front() else { return Ok(()) };
        let result = match session.wait(frame) {
            Ok(result) => result,
            Err(error) => {
                self.skip(name, error)?;
                return Ok(());
            }
        };
        let memory = session.device().memory();
        let (info, count) = (session.device().info().clone(), session.scene().count().into());
        let plan = session.plan().context("no plan after a frame")?;
        let mut kept = Kept::default();
        let outputs = outputs::read(plan, &result.inspected);
        kept.add(result, plan, true);
        let output = kept.output();
        let stats = kept.stats((&name, size), plan, &info, count, memory);
        self.save(stats, output, outputs, stem, progress)
    }

    /// Starts to write the picture of a camera whose frames are finished, and its other outputs. Reports the earlier
    /// pictures that are now written. `stem` is the stem of the picture's file name.
    ///
    /// # Errors
    /// The picture is missing, or the files of an earlier camera cannot be written.
    pub fn save(
        &mut self,
        mut stats: CameraStats,
        output: Option<Pixels>,
        outputs: Vec<Output>,
        stem: String,
        progress: &Progress,
    ) -> Result<()> {
        if self.reads_picture() && output.is_none() {
            bail!("the device returned no picture");
        }
        stats.opened = self.opened;
        self.blind += usize::from(stats.sees_nothing());
        let (files, cameras) = &self.files;
        let file = |(name, file, format): &(String, PathBuf, Format)| {
            (name.clone(), per_camera(file, *format, &stem, *cameras))
        };
        let files: Vec<(String, PathBuf)> = files.iter().map(file).collect();
        stats.files = files.iter().map(|(name, file)| (name.clone(), text_of(file))).collect();
        let picture = self.destination.as_ref().map(|destination| destination.path(&stem));
        stats.files.extend(picture.map(|file| (PICTURE.to_owned(), text_of(&file))));
        let output_bytes: usize = outputs.iter().map(|output| 4 * output.words.len()).sum();
        // Four floats per pixel.
        let makes_rgba = files.iter().any(|(name, _)| name == RGBA.0);
        let rgba_bytes = if makes_rgba { 16 * u64::from(stats.width) * u64::from(stats.height) } else { 0 };
        let bytes = output_bytes as u64 + rgba_bytes + output.as_ref().map_or(0, pictures::encoding_bytes);
        let (destination, background) = (self.destination.clone(), self.background);
        let pixels_held = self.pixels.0.clone();
        let convert = |pixels: Option<Pixels>| {
            info_span!("convert the pixels").in_scope(|| pixels.as_ref().map(image_of).transpose())
        };
        // The only picture is converted here, by all threads; others while the next one is drawn.
        let (output, converted) = if *cameras == 1 { (None, convert(output)?) } else { (output, None) };
        let work = move || {
            let image = converted.map_or_else(|| convert(output), |image| Ok(Some(image)))?;
            // The readback memory is back at the device before encoding.
            drop(pixels_held);
            let mut notes = Vec::new();
            for (name, path) in &files {
                let source = outputs.iter().find(|output| output.name == outputs::source_of(name));
                let output = outputs::named(name, source, image.as_ref(), background);
                let output = output.with_context(|| format!("the device returned no output `{name}`"))?;
                notes.extend(output.save(path)?.and_then(|found| found.note(path.display())));
            }
            let line = match (destination, image) {
                (Some(destination), Some(image)) => {
                    let path = destination.path(&stem);
                    let not_finite = image.save_as(destination.format(), &path)?;
                    stats.not_finite = not_finite.map(|found| found.pixels);
                    notes.extend(not_finite.and_then(|found| found.note(path.display())));
                    format!("{}: {} x {}, {}", path.display(), image.width, image.height, stats.line())
                }
                _ => {
                    let written: Vec<String> =
                        files.iter().map(|(_, path)| path.display().to_string()).collect();
                    let name = if written.is_empty() { stats.camera.clone() } else { written.join(", ") };
                    format!("{}: {}", one_line(&name), stats.line())
                }
            };
            Ok(Told { stats, line, notes })
        };
        for told in self.pictures.start(bytes, work)? {
            self.tell(told, progress)?;
        }
        Ok(())
    }

    /// Waits until no unfinished picture uses the device's readback memory.
    pub fn wait_for_pixels(&mut self) {
        let _span = info_span!("wait for pixels").entered();
        let (sender, receiver) = std::mem::replace(&mut self.pixels, channel());
        drop(sender);
        _ = receiver.recv();
    }

    /// Waits until all pictures are written. Returns the statistics of all cameras so far, in order; empty if none are
    /// kept.
    pub fn finish(&mut self, progress: &Progress) -> Result<&[CameraStats]> {
        let _span = info_span!("wait for files").entered();
        while let Some(told) = self.pictures.wait()? {
            self.tell(told, progress)?;
        }
        Ok(self.done.as_deref().unwrap_or_default())
    }

    fn tell(&mut self, Told { stats, line, notes }: Told, progress: &Progress) -> Result<()> {
        progress.suspend(|| {
            notes.iter().for_each(say);
            self.stdout.line(&line)
        })?;
        if let Some(done) = &mut self.done {
            done.push(stats);
        }
        Ok(())
    }
}
