//! Defines what all film formats share: encoded frames, the writer of a film, and the frame rate.

use crate::io::output::file::Cause;
use std::fmt;
use std::str::FromStr;

/// A frame encoded by `Format::encode`, for a [`Writer`] of the same format.
pub enum Frame {
    /// Bytes that the writer writes or compresses.
    Bytes(Vec<u8>),
    /// An image of a GIF.
    Gif(Box<gif::Frame<'static>>),
}

/// Writes the frames of a film in order.
pub trait Writer {
    /// Writes the next frame.
    ///
    /// # Errors
    /// The frame was encoded for another format, or it cannot be compressed or written.
    fn add(&mut self, frame: Frame) -> Result<(), Cause>;

    /// Writes the end of the film.
    ///
    /// # Errors
    /// The remaining frames cannot be compressed or written.
    fn finish(self: Box<Self>) -> Result<(), Cause>;
}

/// Makes the error for a frame that was encoded for another format.
pub(super) fn mixed() -> Cause {
    "expected a frame of this film's format, found another".into()
}

/// A frame rate: frames per second, as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    pub(super) frames: u32,
    pub(super) seconds: u32,
}

impl Rate {
    /// Returns a usual rate near `fps`: a whole number, one of NTSC's, or a number of thousandths. `None` outside of
    /// 0.1 to 1000.
    pub fn near(fps: f64) -> Option<Rate> {
        let ntsc = (1.001 * fps).round();
        let text = match fps {
            _ if (fps - fps.round()).abs() < 1e-3 => fps.round().to_string(),
            _ if fps > 23.0 && (fps - ntsc / 1.001).abs() < 5e-3 => format!("{}/1001", 1000.0 * ntsc),
            _ if (2.0 * fps).fract() == 0.0 => format!("{}/2", 2.0 * fps),
            _ => format!("{}/1000", (1000.0 * fps).round()),
        };
        text.parse().ok()
    }

    /// Returns the rate in frames per second.
    pub fn per_second(self) -> f64 {
        f64::from(self.frames) / f64::from(self.seconds)
    }
}

impl Default for Rate {
    fn default() -> Rate {
        Rate { frames: 30, seconds: 1 }
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.seconds {
            1 => self.frames.fmt(f),
            seconds => write!(f, "{}/{seconds}", self.frames),
        }
    }
}

impl FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Rate, String> {
        // The usual short names of NTSC's rates.
        let text = match text {
            "23.976" | "23.98" => "24000/1001",
            "29.97" => "30000/1001",
            "59.94" => "60000/1001",
            other => other,
        };
        let (frames, seconds) = text.split_once('/').unwrap_or((text, "1"));
        let parsed = frames.trim().parse().ok().zip(seconds.trim().parse().ok());
        let rate = parsed.map(|(frames, seconds)| Rate { frames, seconds });
        rate.filter(|rate| (0.1..=1000.0).contains(&rate.per_second()) && rate.frames <= 1_000_000)
            .ok_or_else(|| {
                "expected 0.1 to 1000 frames per second as a whole number or a fraction, for instance 30 or 30000/1001"
                    .into()
            })
    }
}
