//! Writes films: pictures at a constant frame rate in one file.
//!
//! [`Format::encode`] does the work that depends on one frame alone, on any thread. A [`Writer`] then takes the results
//! in order. Values are clamped to 0..1, as in 8-bit pictures.
//!
//! - `.gif`: NeuQuant chooses 256 colours for each frame, and the most frequent colour is exact; nothing is dithered,
//!   because dithered pictures compress badly;
//! - `.apng` and `.png` are animated PNGs, and keep all 8 bits of each channel;
//! - `.y4m` is uncompressed video, for a pipe into an encoder;
//! - `.mp4` is AV1, in programs that were built with the feature `av1`.

mod apng;
#[cfg(feature = "av1")]
mod av1;
mod frame;
mod gif;
mod y4m;

use crate::io::image::{Image, NotFinite};
use crate::io::output::file::Cause;
use std::io::Write;
use std::path::Path;

pub use frame::{Frame, Rate, Writer};

/// The file formats of films.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// GIF, looping.
    Gif,
    /// Animated PNG, looping.
    Apng,
    /// YUV4MPEG2: 4:2:0, BT.709, limited range.
    Y4m,
    /// AV1 in MP4.
    #[cfg(feature = "av1")]
    Mp4,
}

impl Format {
    /// Returns the format for a path's extension, in upper or lower case; `None` if it is not a film's.
    pub fn of(path: &Path) -> Option<Format> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "gif" => Some(Format::Gif),
            "apng" | "png" => Some(Format::Apng),
            "y4m" => Some(Format::Y4m),
            #[cfg(feature = "av1")]
            "mp4" => Some(Format::Mp4),
            _ => None,
        }
    }

    /// Checks that players show the format at a frame rate.
    ///
    /// # Errors
    /// The format is GIF and the rate is above 50 frames per second: players slow shorter frames down.
    pub fn check_rate(self, rate: Rate) -> Result<(), String> {
        // The delays of a GIF are hundredths of a second, and browsers replace delays below 0.02 s by 0.1 s.
        if self == Format::Gif && rate.per_second() > 50.0 {
            return Err(format!(
                "expected at most 50 frames per second in a .gif, found {rate}: players show shorter frames for 0.1 s; an .apng keeps the rate"
            ));
        }
        Ok(())
    }

    /// Encodes a frame as far as possible without the other frames. Also counts its pixels that are not finite.
    ///
    /// # Errors
    /// The picture is too large for the format.
    pub fn encode(self, image: &Image) -> Result<(Frame, NotFinite), Cause> {
        let (bytes, not_finite) = match self {
            Format::Gif => {
                let (frame, not_finite) = gif::encode(image)?;
                return Ok((Frame::Gif(Box::new(frame)), not_finite));
            }
            Format::Apng => image.bytes(),
            Format::Y4m => y4m::encode(image),
            #[cfg(feature = "av1")]
            Format::Mp4 => y4m::planes(image),
        };
        Ok((Frame::Bytes(bytes), not_finite))
    }

    /// Begins a film of exactly `frames` frames. `size` is the width and height, in pixels.
    ///
    /// # Errors
    /// `out` fails, or the format does not support the film's size, rate or length.
    pub fn begin<'a>(
        self,
        out: &'a mut dyn Write,
        size: (u32, u32),
        rate: Rate,
        frames: u32,
    ) -> Result<Box<dyn Writer + 'a>, Cause> {
        self.check_rate(rate)?;
        Ok(match self {
            Format::Gif => Box::new(gif::Film::begin(out, size, rate)?),
            Format::Apng => Box::new(apng::Film::begin(out, size, rate, frames)?),
            Format::Y4m => Box::new(y4m::Film::begin(out, size, rate)?),
            #[cfg(feature = "av1")]
            Format::Mp4 => Box::new(av1::Film::begin(out, size, rate, frames)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (9, 5);

    fn picture(frame: usize) -> Image {
        Image::from_fn(SIZE.0 as usize, SIZE.1 as usize, |x, y| {
            [((x + frame) % 4) as f32 / 3.0, y as f32 / 4.0, 0.2 * frame as f32]
        })
    }

    fn film(format: Format, rate: &str) -> Vec<u8> {
        let mut bytes = Vec::new();
        let rate = rate.parse().expect("a rate");
        let mut writer = format.begin(&mut bytes, SIZE, rate, 4).expect("a film");
        for frame in 0..4 {
            writer.add(format.encode(&picture(frame)).expect("a frame").0).expect("written");
        }
        writer.finish().expect("an end");
        bytes
    }

    #[test]
    fn a_gif_has_every_frame_with_its_colours_and_keeps_the_time_in_hundredths() {
        let mut options = ::gif::DecodeOptions::new();
        options.set_color_output(::gif::ColorOutput::RGBA);
        let bytes = film(Format::Gif, "30");
        let mut decoder = options.read_info(bytes.as_slice()).expect("a GIF");
        assert_eq!((decoder.width(), decoder.height()), (9, 5));
        let mut delays = Vec::new();
        while let Some(frame) = decoder.read_next_frame().expect("a frame") {
            let expected = picture(delays.len()).bytes().0;
            let found: Vec<u8> = frame.buffer.chunks(4).flat_map(|p| p[..3].to_vec()).collect();
            assert_eq!(found, expected, "frame {}", delays.len());
            delays.push(frame.delay);
        }
        // Four frames take 13.3 hundredths of a second.
        assert_eq!(delays, [3, 4, 3, 3]);
        assert_eq!(decoder.repeat(), ::gif::Repeat::Infinite);
    }

    #[test]
    fn a_small_part_of_a_gif_keeps_its_colours_and_the_background_is_exact() {
        let level = |value: usize| value as f32 / 255.0;
        let image = Image::from_fn(160, 90, |x, y| match (x, y) {
            (0..40, 0..40) => [level(6 * x), level(6 * y), level(3 * (x + y))],
            (50..55, 0..5) => [level(200), level(x - 10), level(10 + y)],
            _ => [0.2, 0.4, 0.6],
        });
        let mut bytes = Vec::new();
        let rate = Rate::default();
        let mut writer = Format::Gif.begin(&mut bytes, (160, 90), rate, 1).expect("a film");
        writer.add(Format::Gif.encode(&image).expect("a frame").0).expect("written");
        writer.finish().expect("an end");
        let mut options = ::gif::DecodeOptions::new();
        options.set_color_output(::gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(bytes.as_slice()).expect("a GIF");
        let frame = decoder.read_next_frame().expect("a frame").expect("one");
        let expected = image.bytes().0;
        let error = |x: usize, y: usize| {
            let pixels = frame.buffer[4 * (160 * y + x)..].iter().zip(&expected[3 * (160 * y + x)..]);
            pixels.take(3).map(|(a, b)| a.abs_diff(*b)).max()
        };
        let part = (50..55).flat_map(|x| (0..5).map(move |y| (x, y)));
        let worst = part.filter_map(|(x, y)| error(x, y)).max();
        assert!(worst < Some(25), "{worst:?}");
        assert_eq!(error(100, 80), Some(0));
    }

    #[test]
    fn every_format_counts_the_pixels_that_it_cannot_hold() {
        let mut image = picture(0);
        (image.rgb[1], image.rgb[7]) = ([0.5, f32::NAN, f32::NAN], [f32::INFINITY, 0.0, 0.0]);
        for name in ["a.gif", "a.apng", "a.y4m"] {
            let format = Format::of(Path::new(name)).expect("a format");
            assert_eq!(format.encode(&image).expect("a frame").1, NotFinite { pixels: 2, of: 45 }, "{name}");
        }
    }

    #[test]
    fn a_gif_has_no_delay_that_players_lengthen() {
        let rate = |text: &str| text.parse::<Rate>().expect("a rate");
        for allowed in ["50", "25", "1/10"] {
            assert_eq!(Format::Gif.check_rate(rate(allowed)), Ok(()));
        }
        for refused in ["60", "200", "60000/1001"] {
            assert!(Format::Gif.check_rate(rate(refused)).is_err_and(|error| error.contains(refused)));
            assert!(Format::Gif.begin(&mut Vec::new(), SIZE, rate(refused), 4).is_err());
            assert_eq!(Format::Apng.check_rate(rate(refused)), Ok(()));
        }
    }

    #[test]
    fn an_animated_png_has_every_frame_bit_by_bit() {
        let read = |rate| {
            let bytes = film(Format::Apng, rate);
            png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("a PNG")
        };
        // Also rates whose numbers exceed 16 bits.
        for (rate, delay) in [("60", 1..60), ("120000/1001", 342..40999), ("100000/1001", 651..65035)] {
            let control = *read(rate).info().frame_control().expect("a frame's control");
            assert_eq!(u32::from(control.delay_num)..u32::from(control.delay_den), delay, "{rate}");
        }
        let mut reader = read("30000/1001");
        let animation = *reader.info().animation_control().expect("an animation");
        assert_eq!((animation.num_frames, animation.num_plays), (4, 0));
        for frame in 0..4 {
            let mut found = vec![0; reader.output_buffer_size().expect("a size")];
            reader.next_frame(&mut found).expect("a frame");
            let control = *reader.info().frame_control().expect("a frame's control");
            assert_eq!((control.delay_num, control.delay_den), (1001, 30000));
            assert_eq!(found, picture(frame).bytes().0, "frame {frame}");
        }
    }

    #[test]
    fn y4m_has_a_header_and_planes_of_the_right_sizes_and_values() {
        let bytes = film(Format::Y4m, "25");
        let header = b"YUV4MPEG2 W9 H5 F25:1 Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=LIMITED\n";
        assert_eq!(&bytes[..header.len()], header);
        let frames = &bytes[header.len()..];
        let frame = 6 + 9 * 5 + 2 * 5 * 3;
        assert_eq!(frames.len(), 4 * frame);
        for (at, frame) in frames.chunks(frame).enumerate() {
            assert_eq!(&frame[..6], b"FRAME\n", "frame {at}");
        }
        // BT.709, limited to 16..235 and 16..240 (ITU-R BT.709-6, table 3.5).
        for (rgb, expected) in [
            ([0.0, 0.0, 0.0], [16, 128, 128]),
            ([1.0, 1.0, 1.0], [235, 128, 128]),
            ([1.0, 0.0, 0.0], [63, 102, 240]),
            ([0.0, 0.0, 1.0], [32, 240, 118]),
        ] {
            let planes = y4m::encode(&Image::from_fn(2, 2, |_, _| rgb)).0;
            assert_eq!(planes[6..], [&[expected[0]; 4][..], &expected[1..]].concat(), "{rgb:?}");
        }
    }

    #[cfg(feature = "av1")]
    #[test]
    fn an_mp4_has_every_frame_as_a_sample_of_av1_and_begins_with_a_key() {
        use shiguredo_mp4::demux::{Input, Mp4FileDemuxer};
        let size = (32, 18);
        let mut bytes = Vec::new();
        let rate = "30000/1001".parse().expect("a rate");
        let mut writer = Format::Mp4.begin(&mut bytes, size, rate, 4).expect("a film");
        for frame in 0..4 {
            let picture =
                Image::from_fn(32, 18, |x, y| [x as f32 / 32.0, y as f32 / 18.0, 0.2 * frame as f32]);
            writer.add(Format::Mp4.encode(&picture).expect("a frame").0).expect("written");
        }
        writer.finish().expect("an end");
        let mut demuxer = Mp4FileDemuxer::new();
        demuxer.handle_input(Input { position: 0, data: &bytes });
        let mut keys = Vec::new();
        while let Some(sample) = demuxer.next_sample().expect("a sample") {
            assert_eq!(sample.duration, 1001);
            // A key frame starts with its sequence header (AV1 specification, 5.3.2), not with a temporal delimiter.
            let first = bytes[sample.data_offset as usize];
            assert_eq!(sample.keyframe, first >> 3 == 1, "sample {}", keys.len());
            keys.push(sample.keyframe);
        }
        assert_eq!(keys, [true, false, false, false]);
        assert!(Format::Mp4.begin(&mut Vec::new(), (15, 16), rate, 4).is_err());
    }

    #[test]
    fn rates_are_whole_numbers_and_fractions() {
        for (text, rate) in [("24", 24.0), ("30000/1001", 29.97), ("1/2", 0.5)] {
            let parsed: Rate = text.parse().expect("a rate");
            assert!((parsed.per_second() - rate).abs() < 1e-3);
            assert_eq!(parsed.to_string(), text);
        }
        for (text, exact) in [("23.976", "24000/1001"), ("29.97", "30000/1001"), ("59.94", "60000/1001")] {
            assert_eq!(text.parse(), exact.parse::<Rate>());
        }
        for (fps, rate) in [(24.0, "24"), (29.970_03, "30000/1001"), (12.5, "25/2"), (5.99, "5990/1000")] {
            assert_eq!(Rate::near(fps), Some(rate.parse().expect("a rate")));
        }
        assert_eq!([0.0, -5.0, 1e9, f64::NAN].map(Rate::near), [None; 4]);
        for text in ["", "0", "30/0", "-1", "12.5", "1001", "x", "1/100"] {
            assert!(text.parse::<Rate>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_name_tells_the_format() {
        let of = |name: &str| Format::of(Path::new(name));
        assert_eq!(of("a/film.GIF"), Some(Format::Gif));
        assert_eq!((of("film.apng"), of("film.png")), (Some(Format::Apng), Some(Format::Apng)));
        assert_eq!((of("film.y4m"), of("film"), of("film.webm")), (Some(Format::Y4m), None, None));
    }
}
