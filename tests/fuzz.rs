//! Damages files as an editor or an accident might.

use crate::numbers::Random;

impl Random {
    /// Returns a byte, mostly a character that graphs and shaders use.
    fn byte(&mut self) -> u8 {
        const LIKELY: &[u8] = b"(){}[]<>;,.:\"'#/*+-=!&|%~?\\_ \n\t0123456789abxuifeABXU";
        if self.below(4) > 0 { LIKELY[self.below(LIKELY.len())] } else { self.next() as u8 }
    }
}

/// Damages a file as an editor or an accident might. Returns the kind of damage, and the damaged file.
///
/// The result can equal `text`, for example if a line is swapped with itself. `text` must not be empty.
pub fn damaged(text: &[u8], random: &mut Random) -> (&'static str, Vec<u8>) {
    let mut bytes = text.to_vec();
    let mut lines: Vec<&[u8]> = text.split_inclusive(|byte| *byte == b'\n').collect();
    let [one, other] = [random.below(lines.len()), random.below(lines.len())];
    let what = match random.below(11) {
        0 | 1 => {
            bytes.truncate(random.below(text.len()));
            "cut off"
        }
        2 => {
            // Emptied only half of the time: each file has only one emptied version.
            if random.below(2) == 0 {
                bytes.clear();
                "emptied"
            } else {
                bytes.drain(..random.below(text.len()));
                "without its start"
            }
        }
        3 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
            "with flipped bits"
        }
        4 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] = random.byte();
            }
            "with other bytes"
        }
        5 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes.insert(at, random.byte());
            }
            "with more bytes"
        }
        6 => {
            let start = random.below(bytes.len());
            let end = (start + 1 + random.below(40)).min(bytes.len());
            bytes.drain(start..end);
            "with a gap"
        }
        7 => {
            lines.swap(one, other);
            bytes = lines.concat();
            "with two lines swapped"
        }
        8 => {
            let times = [1, 1, 1, 2, 100][random.below(5)];
            lines.splice(other..other, std::iter::repeat_n(lines[one], times).collect::<Vec<_>>());
            bytes = lines.concat();
            "with a line repeated"
        }
        9 => {
            lines.remove(one);
            bytes = lines.concat();
            "without a line"
        }
        _ => {
            const BAD: [&[u8]; 5] = [b"\xff", b"\xc3\x28", b"\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80"];
            let (at, bad) = (random.below(bytes.len()), BAD[random.below(BAD.len())]);
            bytes.splice(at..at, bad.iter().copied());
            "that is no UTF-8"
        }
    };
    (what, bytes)
}
