//! Damages files at random and runs readers on them: the harness of the fuzz tests. Each case is seeded by its number,
//! so that all runs are equal.
//!
//! Readers return within bounded time and memory, whatever a file contains.

use crate::allocation::{alone, counted};
use crate::long;
use crate::numbers::Random;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Damaged files per reader: in the long form, and by default.
const CASES: (u64, u64) = (100_000, 1_500);

const TIME_LIMIT: Duration = Duration::from_secs(30);

impl Random {
    /// Picks one of the words of a text.
    fn pick<'a>(&mut self, from: &'a str) -> &'a str {
        let words: Vec<&str> = from.split(' ').collect();
        words[self.below(words.len())]
    }
}

/// Numbers at the limits of the readers' types.
const NUMBERS: &str = "0 1 -1 2 9 24 45 127 255 256 65535 65536 2147483647 2147483648 4294967295 4294967296 \
    9223372036854775807 9223372036854775808 18446744073709551615 18446744073709551616 1e40 -1e-50 nan \
    inf";

/// Keywords of the formats.
const WORDS: &str = "ply format ascii binary_little_endian binary_big_endian 1.0 element vertex face property list char \
    uchar short uint int float double end_header comment x opacity f_rest_0 rot_3 position rotation \
    width fx [ }";

/// Damages a file once or twice, possibly with a piece of `other`. Two times in five, the place is in the first `head`
/// bytes, which have the declared sizes; otherwise, it is anywhere.
fn damage(seed: &[u8], head: usize, other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(2) {
        let within = if random.below(5) < 2 { head.min(bytes.len()) } else { bytes.len() };
        let at = random.below(within);
        let end = (at + 1 + random.below(48)).min(bytes.len());
        match random.below(12) {
            _ if bytes.is_empty() => {}
            0 => bytes.truncate(random.below(bytes.len())),
            1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at] = random.next() as u8,
            3 => bytes.insert(at, random.next() as u8),
            4 => drop(bytes.drain(at..end)),
            5 => {
                let copy = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, copy);
            }
            6 => {
                let from = random.below(other.len());
                let piece = &other[from..(from + random.below(200)).min(other.len())];
                bytes.splice(at..end, piece.iter().copied());
            }
            7 | 8 => {
                let number = random.pick(NUMBERS);
                // Replaces a number of the file, if one follows.
                let digit = bytes[at..].iter().position(u8::is_ascii_digit).map_or(at, |digit| at + digit);
                replace_word(&mut bytes, digit, number);
            }
            9 | 10 => {
                let word = random.pick(WORDS);
                replace_word(&mut bytes, at, word);
            }
            _ => {
                let byte = [0, 0x7F, 0x80, 0xFF][random.below(4)];
                bytes[at..end].fill(byte);
            }
        }
    }
    bytes
}

fn replace_word(bytes: &mut Vec<u8>, at: usize, word: &str) {
    let blank = |b: &u8| b.is_ascii_whitespace() || b",:[]{}\"".contains(b);
    let start = bytes[..at].iter().rposition(blank).map_or(0, |blank| blank + 1);
    let end = bytes[at..].iter().position(blank).map_or(bytes.len(), |length| at + length);
    bytes.splice(start..end.max(start), word.bytes());
}

/// Runs the cases of one reader. `seeds` are whole files, which `read` must accept, each with the length of its head.
/// `read` returns the kind of its error; it must end within [`TIME_LIMIT`], and allocate less than `memory` bytes plus
/// 64 times the file's length. The cases must give at least three kinds of answers.
pub fn run(
    name: &str,
    seeds: &[(Vec<u8>, usize)],
    memory: usize,
    read: impl Fn(&[u8]) -> Result<(), String>,
) {
    let _alone = alone();
    // Warm-up: threads and other one-time allocations.
    for (seed, _) in seeds {
        assert_eq!(read(seed), Ok(()), "a seed of {name} is whole");
    }
    let cases = if long() { CASES.0 } else { CASES.1 };
    let mut answers: BTreeMap<String, u64> = BTreeMap::new();
    let (mut most, mut slowest) = (0, Duration::ZERO);
    for case in 0..cases {
        let random = &mut Random(case.wrapping_mul(0x2545_F491_4F6C_DD1D));
        let (seed, head) = &seeds[random.below(seeds.len())];
        let (other, _) = &seeds[random.below(seeds.len())];
        let bytes = damage(seed, *head, other, random);
        let started = Instant::now();
        let (answer, taken) = counted(|| read(&bytes));
        let time = started.elapsed();
        assert!(time < TIME_LIMIT, "case {case} of {name} took {time:?}");
        assert!(
            taken < memory + 64 * bytes.len(),
            "case {case} of {name} took {taken} bytes of memory for {} bytes of file",
            bytes.len()
        );
        (most, slowest) = (most.max(taken), slowest.max(time));
        let kind = answer.map_or_else(|error| error, |()| "read".into());
        *answers.entry(kind).or_default() += 1;
    }
    println!("{name}: {cases} cases, at most {most} bytes and {slowest:?}: {answers:?}");
    assert!(answers.len() > 2, "{name}: the cases are all alike: {answers:?}");
}

/// Returns the kind of a message: its first four words of lower-case letters.
pub fn kind(message: &str) -> String {
    let words = message.split(' ').filter(|w| w.chars().all(|c| c.is_ascii_lowercase()));
    words.take(4).collect::<Vec<_>>().join(" ")
}
