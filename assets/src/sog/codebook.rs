//! Chooses the codebooks of SOG: 256 codes that approximate many numbers.
//!
//! The interval with the largest error is split repeatedly, so that rare numbers far from all others get codes of their
//! own. Lloyd's algorithm (k-means) then moves the borders of all intervals.

use super::meta::CODES;
use crate::bounds::median;
use rayon::prelude::*;
use std::ops::Range;

/// Iterations of Lloyd's algorithm.
const STEPS: usize = 48;

/// Iterations that move the border between the two halves of an interval.
const BORDER_STEPS: usize = 8;

/// Least weight of a number: that of splats that show nothing, which may be many.
pub(super) const MIN_WEIGHT: f32 = 1e-12;
/// Largest weight, in medians of the weights above the least. Prefix sums with larger ones would lose the others to
/// rounding.
const MOST_WEIGHT: f32 = 1e6;

/// A codebook: 256 ascending numbers.
pub(super) struct Codebook {
    pub codes: Vec<f32>,
    /// Midpoints of neighbouring codes: the upper end of the range of each code but the last.
    ends: Vec<f32>,
}

impl Codebook {
    /// Chooses the codes for a nonempty list of finite numbers.
    ///
    /// Each number has a weight above 0, a factor on its squared error. If there are at most 256 distinct numbers,
    /// every code is exact. 0 is exact if it is among the numbers.
    pub(super) fn of(numbers: Vec<(f32, f32)>) -> Self {
        let sorted = Sorted::new(numbers);
        let mut codes: Vec<f32> = sorted.intervals(CODES).iter().map(|of| sorted.mean(of) as f32).collect();
        codes.sort_unstable_by(f32::total_cmp);
        let last = codes[codes.len() - 1];
        codes.resize(CODES, last);
        for _ in 0..STEPS {
            let ends = middles(&codes);
            let mut begin = 0;
            for (code, value) in codes.iter_mut().enumerate() {
                let end = match ends.get(code) {
                    Some(end) => begin + sorted.numbers[begin..].partition_point(|number| number < end),
                    None => sorted.numbers.len(),
                };
                if end > begin {
                    *value = sorted.mean(&(begin..end)) as f32;
                }
                begin = end;
            }
            codes.sort_unstable_by(f32::total_cmp);
        }
        // Bands of harmonics that are all 0 stay unused only if 0 is exact.
        if sorted.numbers.contains(&0.0)
            && let Some(nearest) = codes.iter_mut().min_by(|a, b| a.abs().total_cmp(&b.abs()))
        {
            *nearest = 0.0;
            codes.sort_unstable_by(f32::total_cmp);
        }
        let ends = middles(&codes);
        Self { codes, ends }
    }

    pub(super) fn nearest(&self, number: f32) -> u8 {
        self.ends.partition_point(|end| *end <= number) as u8
    }
}

fn middles(codes: &[f32]) -> Vec<f32> {
    codes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
}

/// Numbers in ascending order, with prefix sums.
struct Sorted {
    numbers: Vec<f32>,
    /// Prefix sums of the weights, of the weighted numbers, and of the weighted squares; the first is 0.
    sums: Vec<[f64; 3]>,
}

impl Sorted {
    fn new(mut weighted: Vec<(f32, f32)>) -> Self {
        weighted.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let weights = weighted.iter().map(|(_, weight)| *weight);
        let mut usual: Vec<f32> = weights.filter(|weight| *weight > MIN_WEIGHT).collect();
        let most = if usual.is_empty() { f32::MAX } else { MOST_WEIGHT * median(&mut usual) };
        let mut sums = Vec::with_capacity(weighted.len() + 1);
        let mut sum = [0.0; 3];
        sums.push(sum);
        for (number, weight) in &weighted {
            let (number, weight) = (f64::from(*number), f64::from(weight.min(most)));
            sum = [sum[0] + weight, sum[1] + weight * number, sum[2] + weight * number * number];
            sums.push(sum);
        }
        Self { numbers: weighted.into_iter().map(|(number, _)| number).collect(), sums }
    }

    fn moments(&self, interval: &Range<usize>) -> [f64; 3] {
        std::array::from_fn(|of| self.sums[interval.end][of] - self.sums[interval.start][of])
    }

    fn is_equal(&self, interval: &Range<usize>) -> bool {
        self.numbers[interval.start] == self.numbers[interval.end - 1]
    }

    /// Returns the weighted mean of an interval, without rounding if its numbers are equal.
    fn mean(&self, interval: &Range<usize>) -> f64 {
        if self.is_equal(interval) {
            return self.numbers[interval.start].into();
        }
        let [weight, sum, _] = self.moments(interval);
        sum / weight
    }

    /// Sums the weighted squared distances from the mean; 0 only if the numbers are equal.
    fn error(&self, interval: &Range<usize>) -> f64 {
        if self.is_equal(interval) {
            return 0.0;
        }
        let [weight, sum, squares] = self.moments(interval);
        (squares - sum * sum / weight).max(f64::MIN_POSITIVE)
    }

    /// Splits the numbers into at most `count` intervals, by splitting the interval with the largest error repeatedly.
    fn intervals(&self, count: usize) -> Vec<Range<usize>> {
        let whole = 0..self.numbers.len();
        let mut intervals = vec![(self.error(&whole), whole)];
        while intervals.len() < count {
            let errors = intervals.iter().map(|(error, _)| *error).enumerate();
            let Some((at, _)) = errors.filter(|(_, error)| *error > 0.0).max_by(|a, b| a.1.total_cmp(&b.1))
            else {
                break;
            };
            let (_, interval) = intervals.swap_remove(at);
            intervals.extend(self.halves(interval).map(|half| (self.error(&half), half)));
        }
        intervals.into_iter().map(|(_, interval)| interval).collect()
    }

    /// Splits an interval at the midpoint between the means of its halves. Its numbers must not all be equal.
    fn halves(&self, interval: Range<usize>) -> [Range<usize>; 2] {
        let numbers = &self.numbers[interval.clone()];
        let [first, last] = [numbers[0], numbers[numbers.len() - 1]];
        let halves = |border: f64| {
            // Rounding can put a mean beyond all numbers. No half may be empty, and equal numbers stay in one half.
            let border = border.max(first.into());
            let is_low = |number: &f32| *number < last && f64::from(*number) <= border;
            let middle = interval.start + numbers.partition_point(is_low);
            [interval.start..middle, middle..interval.end]
        };
        (0..BORDER_STEPS).fold(halves(self.mean(&interval)), |[low, high], _| {
            halves(0.5 * (self.mean(&low) + self.mean(&high)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(numbers: impl IntoIterator<Item = f32>) -> Codebook {
        Codebook::of(numbers.into_iter().map(|number| (number, 1.0)).collect())
    }

    fn coded(codebook: &Codebook, number: f32) -> f32 {
        codebook.codes[usize::from(codebook.nearest(number))]
    }

    #[test]
    fn few_numbers_have_a_code_each_and_many_one_nearby() {
        let codebook = of([3.0, -1.0, 3.0, 0.5]);
        assert_eq!(codebook.codes.len(), CODES);
        for number in [3.0, -1.0, 0.5] {
            assert_eq!(coded(&codebook, number), number);
        }
        let many: Vec<f32> = (0..100_000).map(|i| (i as f32 * 0.37).sin() * 4.0).collect();
        let codebook = of(many.iter().copied());
        let worst = many.iter().map(|number| (coded(&codebook, *number) - number).abs());
        assert!(worst.fold(0.0, f32::max) < 8.0 / 256.0);
    }

    #[test]
    fn numbers_of_extreme_weight_leave_the_codes_of_others_exact_or_near() {
        let weight = |i: usize| if i % 3000 == 7 { 1e16 } else { 1.0 };
        let error = |numbers: &dyn Fn(usize) -> f32| {
            let codebook = Codebook::of((0..30_000).map(|i| (numbers(i), weight(i))).collect());
            let errors = (0..30_000).map(|i| (coded(&codebook, numbers(i)) - numbers(i)).abs());
            errors.fold(0.0, f32::max)
        };
        assert_eq!(error(&|i| ((i % 256) as f32 / 60.0).exp()), 0.0);
        // Hidden splats, even if they are most, do not decide which weight is extreme.
        let heavy = (0..100).map(|i| 10.0 * i as f32 + 0.033);
        let light = (0..30_000).map(|i| (i as f32 / 30.0, if i % 3 == 0 { 1.0 } else { MIN_WEIGHT }));
        let codebook = Codebook::of(light.chain(heavy.clone().map(|number| (number, 1e5))).collect());
        let off = heavy.map(|number| (coded(&codebook, number) - number).abs()).fold(0.0, f32::max);
        assert!(off < 0.05, "{off}");
        let many = error(&|i| (i as f32 * 0.37).sin() * 4.0);
        assert!(many < 0.1, "{many}");
    }

    #[test]
    fn the_codes_of_another_codebook_stay() {
        // The first code has 90,001 equal numbers, the last one has 2.
        let code = |at: usize| ((at as f32 - 100.0) / 60.0).powi(3);
        let codebook = of((0..CODES).flat_map(|at| vec![code(at); 1 + 90_000 / (1 + at * at)]));
        assert!((0..CODES).all(|at| coded(&codebook, code(at)) == code(at)));
    }

    #[test]
    fn zero_is_exact_among_many_numbers() {
        // Few zeros have neighbours on one side, so that the mean of their interval is not 0.
        let near_zero = (0..3000).map(|i| i as f32 * 1e-7);
        let codebook = of(near_zero.chain((0..90_000).map(|i| (i as f32 * 0.37).sin() * 4.0)));
        assert_eq!(coded(&codebook, 0.0), 0.0);
        assert!(codebook.codes.is_sorted());
    }

    #[test]
    fn numbers_of_large_weight_have_near_codes() {
        let number = |i: usize| (i as f32 * 0.37).sin();
        let weight = |i: usize| if i % 100 == 7 { 1000.0 } else { 1.0 };
        let codebook = Codebook::of((0..50_000).map(|i| (number(i), weight(i))).collect());
        let error = |heavy: bool| {
            let of = (0..50_000).filter(|i| (weight(*i) > 1.0) == heavy);
            of.map(|i| (coded(&codebook, number(i)) - number(i)).abs()).fold(0.0, f32::max)
        };
        assert!(error(true) < 0.5 * error(false), "{} and {}", error(true), error(false));
    }
}
