//! Reads `cameras.bin` and `images.bin`. All numbers are little-endian.

use super::lens::{Fault, Lenses, MODELS, open, push};
use crate::dataset::error::CameraError;
use crate::dataset::view::Dataset;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

const MAX_NAME: usize = 4096;

struct Fields<'a> {
    file: BufReader<File>,
    path: &'a Path,
    at: u64,
    length: u64,
}

impl<'a> Fields<'a> {
    fn open(path: &'a Path) -> Result<Self, CameraError> {
        let (file, length) = open(path)?;
        Ok(Self { file, path, at: 0, length })
    }

    fn fault(&self, at: u64, (field, message): Fault) -> CameraError {
        CameraError::invalid(self.path, format!(": byte {at}, `{field}`"), message)
    }

    fn truncated(&self, field: &'static str, expected: u64) -> CameraError {
        let found = self.length.saturating_sub(self.at);
        self.fault(
            self.at,
            (field, format!("expected {expected} bytes, found the end of the file after {found}")),
        )
    }

    fn take<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CameraError> {
        if self.length.saturating_sub(self.at) < N as u64 {
            return Err(self.truncated(field, N as u64));
        }
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(CameraError::io(self.path))?;
        self.at += N as u64;
        Ok(bytes)
    }

    fn word(&mut self, field: &'static str) -> Result<u32, CameraError> {
        Ok(u32::from_le_bytes(self.take(field)?))
    }

    fn long(&mut self, field: &'static str) -> Result<u64, CameraError> {
        Ok(u64::from_le_bytes(self.take(field)?))
    }

    fn double(&mut self, field: &'static str) -> Result<f64, CameraError> {
        Ok(f64::from_le_bytes(self.take(field)?))
    }

    /// Reads a number of entries of at least `bytes` bytes each. Fails if they exceed the rest of the file.
    fn count(&mut self, field: &'static str, bytes: u64) -> Result<u64, CameraError> {
        let (at, count) = (self.at, self.long(field)?);
        let most = (self.length - self.at) / bytes;
        if count > most {
            let text = format!("expected at most {most}, as the rest of the file can hold, found {count}");
            return Err(self.fault(at, (field, text)));
        }
        Ok(count)
    }

    /// Reads a name that ends with a zero byte.
    fn name(&mut self) -> Result<String, CameraError> {
        let (at, mut bytes) = (self.at, Vec::new());
        loop {
            match self.take::<1>("NAME")? {
                [0] => break,
                _ if bytes.len() == MAX_NAME => {
                    let text = format!("expected at most {MAX_NAME} bytes, found more");
                    return Err(self.fault(at, ("NAME", text)));
                }
                [byte] => bytes.push(byte),
            }
        }
        String::from_utf8(bytes).map_err(|error| {
            self.fault(
                at,
                ("NAME", format!("expected UTF-8 text, found \"{}\"", error.as_bytes().escape_ascii())),
            )
        })
    }

    /// Skips bytes; the file must have them.
    fn skip(&mut self, bytes: u64) -> Result<(), CameraError> {
        self.file.seek_relative(bytes as i64).map_err(CameraError::io(self.path))?;
        self.at += bytes;
        Ok(())
    }
}

pub(super) fn lenses(path: &Path, ignore_distortion: bool) -> Result<Lenses, CameraError> {
    let mut fields = Fields::open(path)?;
    let mut lenses = Lenses::new();
    for _ in 0..fields.count("num_cameras", 24 + 3 * 8)? {
        let at = fields.at;
        let (id, number) = (fields.word("CAMERA_ID")?, fields.word("MODEL")?);
        let Some(model) = MODELS.get(number as usize) else {
            let text = format!("expected a model of 0 to {}, found {number}", MODELS.len() - 1);
            return Err(fields.fault(at + 4, ("MODEL", text)));
        };
        let projection = model.projection().map_err(|fault| fields.fault(at + 4, fault))?;
        let [width, height] = [fields.long("WIDTH")?, fields.long("HEIGHT")?];
        let (Ok(width), Ok(height)) = (width.try_into(), height.try_into()) else {
            let text = format!("expected a size of 32 bits, found {width} x {height}");
            return Err(fields.fault(at + 8, ("WIDTH", text)));
        };
        let mut values = [0.0; 12];
        for (value, name) in values.iter_mut().zip(model.parameters) {
            *value = fields.double(name)?;
        }
        let lens = model.lens(projection, (width, height), &values, ignore_distortion).map_err(|fault| {
            let index = model.parameters.iter().position(|name| *name == fault.0).unwrap_or(0);
            fields.fault(at + 24 + 8 * index as u64, fault)
        })?;
        lenses.insert(id, lens);
    }
    Ok(lenses)
}

pub(super) fn images(path: &Path, lenses: &Lenses, dataset: &mut Dataset) -> Result<(), CameraError> {
    /// Size of an image's point, in bytes: two coordinates, and the number of the 3D point.
    const POINT: u64 = 24;
    let mut fields = Fields::open(path)?;
    for _ in 0..fields.count("num_images", 64 + 1 + 8)? {
        let at = fields.at;
        let id = fields.word("IMAGE_ID")?;
        let mut pose = [0.0; 7];
        for (value, name) in pose.iter_mut().zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"]) {
            *value = fields.double(name)?;
        }
        let [w, x, y, z, translation @ ..] = pose;
        let lens = fields.word("CAMERA_ID")?;
        let name = fields.name()?;
        push(dataset, lenses, (id, lens), ([w, x, y, z], translation), name).map_err(|fault| {
            let within = match fault.0 {
                "QW" => 4,
                "CAMERA_ID" => 60,
                _ => 0,
            };
            fields.fault(at + within, fault)
        })?;
        let points = fields.count("num_points2D", POINT)?;
        fields.skip(points * POINT)?;
    }
    Ok(())
}
