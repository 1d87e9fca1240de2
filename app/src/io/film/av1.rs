//! Writes AV1 in MP4.
//!
//! The encoded film is kept in memory until its end, because a box near the start of the file describes all frames.
//! Colours are converted as in [`super::y4m`], and the stream declares their encoding.

use super::frame::{Frame, Rate, Writer, mixed};
use crate::io::output::file::Cause;
use rav1e::prelude::*;
use shiguredo_mp4::boxes::{Av01Box, Av1cBox, SampleEntry, VisualSampleEntryFields};
use shiguredo_mp4::mux::{Mp4FileMuxer, Mp4FileMuxerOptions, Sample, estimate_maximum_moov_box_size};
use shiguredo_mp4::{TrackKind, Uint};
use std::io::Write;
use std::num::NonZeroU32;

/// Quantizer, 0 (lossless) to 255.
const QUANTIZER: usize = 80;
/// Preset of rav1e, 0 (slowest) to 10.
const SPEED: u8 = 8;
/// Maximum number of frames between two key frames, to which players can seek.
const KEY_INTERVAL: u64 = 120;
/// OBU at the start of each packet, which MP4 does not store.
const TEMPORAL_DELIMITER: [u8; 2] = [0x12, 0];

pub(super) struct Film<'a> {
    out: &'a mut dyn Write,
    context: Context<u8>,
    muxer: Mp4FileMuxer,
    /// The file so far: its initial boxes, then the encoded packets.
    bytes: Vec<u8>,
    size: (u32, u32),
    rate: Rate,
    packets: u32,
}

impl<'a> Film<'a> {
    pub(super) fn begin(
        out: &'a mut dyn Write,
        (width, height): (u32, u32),
        rate: Rate,
        frames: u32,
    ) -> Result<Self, Cause> {
        if width.min(height) < 16 || width.max(height) > u32::from(u16::MAX) {
            return Err(format!(
                "expected 16 to 65535 pixels across and down for AV1, found {width} x {height}"
            )
            .into());
        }
        let threads = rayon::current_num_threads();
        let mut settings = EncoderConfig::with_speed_preset(SPEED);
        settings.width = width as usize;
        settings.height = height as usize;
        settings.time_base = Rational::new(rate.seconds.into(), rate.frames.into());
        settings.chroma_sampling = ChromaSampling::Cs420;
        settings.pixel_range = PixelRange::Limited;
        settings.color_description = Some(ColorDescription {
            color_primaries: ColorPrimaries::BT709,
            transfer_characteristics: TransferCharacteristics::SRGB,
            matrix_coefficients: MatrixCoefficients::BT709,
        });
        settings.quantizer = QUANTIZER;
        settings.max_key_frame_interval = KEY_INTERVAL;
        settings.tiles = threads;
        let config = Config::new().with_encoder_config(settings).with_threads(threads);
        let options = Mp4FileMuxerOptions {
            reserved_moov_box_size: estimate_maximum_moov_box_size(&[frames as usize]),
            ..Mp4FileMuxerOptions::default()
        };
        let muxer = Mp4FileMuxer::with_options(options)?;
        let bytes = muxer.initial_boxes_bytes().to_vec();
        Ok(Film {
            out,
            context: config.new_context()?,
            muxer,
            bytes,
            size: (width, height),
            rate,
            packets: 0,
        })
    }

    fn receive(&mut self) -> Result<(), Cause> {
        loop {
            match self.context.receive_packet() {
                Ok(packet) => self.append(&packet)?,
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn append(&mut self, packet: &Packet<u8>) -> Result<(), Cause> {
        let data = packet.data.strip_prefix(&TEMPORAL_DELIMITER).unwrap_or(&packet.data);
        let data_offset = self.bytes.len() as u64;
        self.bytes.extend_from_slice(data);
        let entry = (self.packets == 0).then(|| self.entry());
        self.packets += 1;
        Ok(self.muxer.append_sample(&Sample {
            track_kind: TrackKind::Video,
            sample_entry: entry,
            keyframe: packet.frame_type == FrameType::KEY,
            timescale: NonZeroU32::new(self.rate.frames).unwrap_or(NonZeroU32::MIN),
            duration: self.rate.seconds,
            composition_time_offset: None,
            data_offset,
            data_size: data.len(),
        })?)
    }

    /// Describes the stream, for the first sample: main profile, 8 bits, 4:2:0, maximum level.
    fn entry(&self) -> SampleEntry {
        let (width, height) = (self.size.0 as u16, self.size.1 as u16);
        SampleEntry::Av01(Av01Box {
            visual: VisualSampleEntryFields {
                data_reference_index: VisualSampleEntryFields::DEFAULT_DATA_REFERENCE_INDEX,
                width,
                height,
                horizresolution: VisualSampleEntryFields::DEFAULT_HORIZRESOLUTION,
                vertresolution: VisualSampleEntryFields::DEFAULT_VERTRESOLUTION,
                frame_count: VisualSampleEntryFields::DEFAULT_FRAME_COUNT,
                compressorname: VisualSampleEntryFields::NULL_COMPRESSORNAME,
                depth: VisualSampleEntryFields::DEFAULT_DEPTH,
            },
            av1c_box: Av1cBox {
                seq_profile: Uint::new(0),
                seq_level_idx_0: Uint::new(31),
                seq_tier_0: Uint::new(0),
                high_bitdepth: Uint::new(0),
                twelve_bit: Uint::new(0),
                monochrome: Uint::new(0),
                chroma_subsampling_x: Uint::new(1),
                chroma_subsampling_y: Uint::new(1),
                chroma_sample_position: Uint::new(0),
                initial_presentation_delay_minus_one: None,
                config_obus: Vec::new(),
            },
            unknown_boxes: Vec::new(),
        })
    }
}

impl Writer for Film<'_> {
    fn add(&mut self, frame: Frame) -> Result<(), Cause> {
        let Frame::Bytes(bytes) = frame else { return Err(mixed()) };
        let mut picture = self.context.new_frame();
        let [width, height] = [self.size.0, self.size.1].map(|side| side as usize);
        let (luma, chroma) = bytes.split_at(width * height);
        let across = width.div_ceil(2);
        let (blue, red) = chroma.split_at(across * height.div_ceil(2));
        for (plane, (values, stride)) in
            picture.planes.iter_mut().zip([(luma, width), (blue, across), (red, across)])
        {
            plane.copy_from_raw_u8(values, stride, 1);
        }
        self.context.send_frame(picture)?;
        self.receive()
    }

    fn finish(mut self: Box<Self>) -> Result<(), Cause> {
        self.context.flush();
        self.receive()?;
        for (offset, boxes) in self.muxer.finalize()?.offset_and_bytes_pairs() {
            let start = offset as usize;
            let end = start + boxes.len();
            self.bytes.resize(self.bytes.len().max(end), 0);
            self.bytes[start..end].copy_from_slice(boxes);
        }
        Ok(self.out.write_all(&self.bytes)?)
    }
}
