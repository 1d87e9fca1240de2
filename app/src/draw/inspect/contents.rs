//! Interprets the contents of a resource as numbers, a histogram or a picture.

use crate::io::image::Image;
use serde::Serialize;
use splatgraph_assets::grouped;
use std::fmt;
use std::ops::Range;

/// Color of pixels that have infinite or NaN values.
const MAGENTA: [f32; 3] = [1.0, 0.0, 1.0];

/// Contents of a resource, as 32-bit words.
#[derive(Clone, Debug, PartialEq)]
pub enum Words {
    /// Words of a buffer, or of an image of integers.
    Uint(Vec<u32>),
    /// Values of an image of floats.
    Float(Vec<f32>),
}

/// Type of a buffer's words; an image's texels have the type of its format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReadAs {
    /// Unsigned integers.
    #[default]
    Uint,
    /// Signed integers, from the bits of the words.
    Int,
    /// Floats, from the bits of the words.
    Float,
}

/// Summary of the values of one channel of an image, or of one word of a buffer's elements.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Values {
    /// Name of the word in the shader, such as `root.x`; empty without one.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Smallest finite value; `None` if there is none.
    pub min: Option<f64>,
    /// Largest finite value; `None` if there is none.
    pub max: Option<f64>,
    /// Number of zeros.
    pub zeros: u64,
    /// Number of NaN values.
    pub nan: u64,
    /// Number of infinite values.
    pub infinite: u64,
}

/// A histogram of values.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Smallest and largest finite value; zeros if there is none.
    pub range: [f64; 2],
    /// Number of finite values in each bin. The bins divide the range equally; with one distinct value, all are in the
    /// first.
    pub counts: Vec<u64>,
    /// Number of infinite and NaN values.
    pub not_finite: u64,
}

impl fmt::Display for Values {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match (self.min, self.max) {
            (Some(min), Some(max)) => write!(f, "{} to {}", shown(min), shown(max))?,
            _ => f.write_str("no finite value")?,
        }
        let counts = [(self.zeros, "zeros"), (self.nan, "NaN"), (self.infinite, "infinite")];
        let mut counts = counts.into_iter().filter(|(count, _)| *count > 0);
        counts.try_for_each(|(count, what)| write!(f, ", {} {what}", grouped(count)))
    }
}

/// Formats the value of a word: a fraction, or a number above 2^53, with the digits of an f32, not of an f64.
pub(super) fn shown(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 9e15 { value.to_string() } else { (value as f32).to_string() }
}

impl Words {
    /// Returns the number of words.
    pub fn len(&self) -> usize {
        match self {
            Words::Uint(words) => words.len(),
            Words::Float(words) => words.len(),
        }
    }

    /// Returns true if there are no words.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Reads the word at `index` as a number; `None` beyond the end. Values of an image of floats ignore `read`.
    pub fn number(&self, index: usize, read: ReadAs) -> Option<f64> {
        Some(match (self, read) {
            (Words::Uint(words), ReadAs::Uint) => (*words.get(index)?).into(),
            (Words::Uint(words), ReadAs::Int) => words.get(index)?.cast_signed().into(),
            (Words::Uint(words), ReadAs::Float) => f32::from_bits(*words.get(index)?).into(),
            (Words::Float(words), _) => (*words.get(index)?).into(),
        })
    }

    /// Formats the word at `index`, a float with six decimals; `None` beyond the end.
    pub fn text(&self, index: usize, read: ReadAs) -> Option<String> {
        Some(match (self, read) {
            (Words::Uint(_), ReadAs::Uint | ReadAs::Int) => self.number(index, read)?.to_string(),
            _ => format!("{:.6}", self.number(index, read)?),
        })
    }

    /// Summarises the values of every `stride`th word from the index `first` on.
    pub fn values(&self, first: usize, stride: usize, read: ReadAs) -> Values {
        let mut values = Values { name: String::new(), min: None, max: None, zeros: 0, nan: 0, infinite: 0 };
        let indices = (first..self.len()).step_by(stride.max(1));
        for value in indices.filter_map(|index| self.number(index, read)) {
            values.zeros += u64::from(value == 0.0);
            values.nan += u64::from(value.is_nan());
            values.infinite += u64::from(value.is_infinite());
            if value.is_finite() {
                values.min = Some(values.min.map_or(value, |min| min.min(value)));
                values.max = Some(values.max.map_or(value, |max| max.max(value)));
            }
        }
        values
    }

    /// Counts the values of every `stride`th word with an index in `range`.
    ///
    /// The `bins` bins divide the range of the finite values equally.
    pub fn histogram(&self, range: Range<usize>, stride: usize, read: ReadAs, bins: usize) -> Histogram {
        let range = range.start.min(self.len())..range.end.min(self.len());
        let numbers = || range.clone().step_by(stride.max(1)).filter_map(|index| self.number(index, read));
        let finite = || numbers().filter(|v| v.is_finite());
        let least = finite().fold(f64::INFINITY, f64::min);
        let greatest = finite().fold(f64::NEG_INFINITY, f64::max);
        let bins = bins.max(1);
        let mut counts = vec![0; bins];
        let mut found = 0;
        for value in finite() {
            found += 1;
            let share = if greatest > least { (value - least) / (greatest - least) } else { 0.0 };
            let bin = ((share * bins as f64) as usize).min(bins - 1);
            counts[bin] += 1;
        }
        let range = if found == 0 { [0.0, 0.0] } else { [least, greatest] };
        Histogram { range, counts, not_finite: numbers().count() as u64 - found }
    }

    /// Converts an image to a picture: `[height, width, channels]` in colour, `[height, width]` in grey.
    ///
    /// A fourth channel is ignored. Values between 0 and 1 are unchanged; a wider range is scaled to 0 to 1. Pixels
    /// with infinite or NaN values are magenta. `None` for other shapes, for a shape that does not match the number of
    /// words, and without words.
    pub fn picture(&self, shape: &[u64]) -> Option<Image> {
        let (height, width, channels) = match *shape {
            [height, width] => (height as usize, width as usize, 1),
            [height, width, channels] => (height as usize, width as usize, channels as usize),
            _ => return None,
        };
        if self.len() != width * height * channels || self.is_empty() {
            return None;
        }
        let value = |index: usize| self.number(index, ReadAs::Uint).filter(|v| v.is_finite()).unwrap_or(0.0);
        let shown = channels.min(3);
        let colours = || (0..width * height).flat_map(move |p| (0..shown).map(move |c| p * channels + c));
        let least = colours().map(value).fold(0.0, f64::min);
        let greatest = colours().map(value).fold(1.0, f64::max);
        let scaled = |index: usize| ((value(index) - least) / (greatest - least)) as f32;
        let is_finite = |index: usize| self.number(index, ReadAs::Uint).is_some_and(f64::is_finite);
        Some(Image::from_fn(width, height, |x, y| {
            let pixel = (y * width + x) * channels;
            if !(pixel..pixel + shown).all(is_finite) {
                return MAGENTA;
            }
            std::array::from_fn(|c| scaled(pixel + c.min(shown - 1)))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_is_read_as_an_integer_or_bit_for_bit_as_a_float() {
        let words = Words::Uint(vec![7, 1.5f32.to_bits(), u32::MAX]);
        assert_eq!(words.text(0, ReadAs::Uint).unwrap(), "7");
        assert_eq!(words.text(2, ReadAs::Int).unwrap(), "-1");
        assert_eq!(words.number(1, ReadAs::Float), Some(1.5));
        assert_eq!(words.text(3, ReadAs::Uint), None);
    }

    #[test]
    fn a_histogram_spans_the_finite_values_and_counts_the_others_apart() {
        let words = Words::Float(vec![0.0, 1.0, 2.0, 4.0, f32::NAN, f32::INFINITY]);
        let found = words.histogram(0..6, 1, ReadAs::Uint, 4);
        assert_eq!(found, Histogram { range: [0.0, 4.0], counts: vec![1, 1, 1, 1], not_finite: 2 });
        let evens = words.histogram(0..4, 2, ReadAs::Uint, 2);
        assert_eq!(evens.counts, [1, 1]);
        assert_eq!(words.histogram(4..5, 1, ReadAs::Uint, 2).range, [0.0, 0.0]);
        assert_eq!(Words::Uint(vec![5; 3]).histogram(0..3, 1, ReadAs::Uint, 3).counts, [3, 0, 0]);
    }

    #[test]
    fn a_summary_counts_zeros_and_values_that_are_not_finite_in_one_channel() {
        let words = Words::Float(vec![0.0, 9.0, f32::NAN, 9.0, -2.0, 9.0, f32::INFINITY, 9.0, 0.0, 9.0]);
        let found = words.values(0, 2, ReadAs::Uint);
        let values = |min, max, [zeros, nan, infinite]: [u64; 3]| Values {
            name: String::new(),
            min: Some(min),
            max: Some(max),
            zeros,
            nan,
            infinite,
        };
        assert_eq!(found, values(-2.0, 0.0, [2, 1, 1]));
        assert_eq!(words.values(1, 2, ReadAs::Uint), values(9.0, 9.0, [0; 3]));
        assert_eq!(Words::Float(vec![f32::NAN]).values(0, 1, ReadAs::Uint).min, None);
        let text = |words: Words| words.values(0, 1, ReadAs::Uint).to_string();
        assert_eq!(text(Words::Float(vec![0.1, 0.7, f32::NAN])), "0.1 to 0.7, 1 NaN");
        assert_eq!(text(Words::Uint(vec![0, u32::MAX])), "0 to 4294967295, 1 zeros");
    }

    #[test]
    fn an_image_of_one_channel_is_grey_and_large_values_are_stretched() {
        let grey = Words::Uint(vec![0, 2, 4, 1]).picture(&[2, 2]).unwrap();
        assert_eq!((grey.at(0, 0), grey.at(0, 1)), ([0.0; 3], [1.0; 3]));
        let colour = Words::Float(vec![0.25, 0.5, 1.0, 9.0]).picture(&[1, 1, 4]).unwrap();
        assert_eq!(colour.at(0, 0), [0.25, 0.5, 1.0], "alpha stretches nothing");
        assert_eq!(Words::Uint(vec![1; 6]).picture(&[6]), None);
        let holes = Words::Float(vec![0.5, f32::NAN, f32::INFINITY, 0.25]).picture(&[2, 2]).unwrap();
        assert_eq!([holes.at(0, 0), holes.at(1, 0), holes.at(0, 1)], [[0.5; 3], MAGENTA, MAGENTA]);
    }
}
