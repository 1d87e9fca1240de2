//! Defines the types of numbers in files, and reads their values from bytes.

use half::f16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
    F16,
}

/// Name and size in bytes of each type, in the order of [`Scalar`].
const TYPES: [(&str, usize); 9] = [
    ("char", 1),
    ("uchar", 1),
    ("short", 2),
    ("ushort", 2),
    ("int", 4),
    ("uint", 4),
    ("float", 4),
    ("double", 8),
    ("half", 2),
];

impl Scalar {
    pub(crate) fn name(self) -> &'static str {
        TYPES[self as usize].0
    }

    /// Returns the size of a value in a binary file, in bytes.
    #[inline]
    pub(crate) fn size(self) -> usize {
        TYPES[self as usize].1
    }

    /// Reads the value at the start of `bytes` as f32; doubles are rounded, integers converted. `BIG` is true for
    /// big-endian bytes.
    #[inline]
    pub(crate) fn value<const BIG: bool>(self, bytes: &[u8]) -> f32 {
        match self {
            Self::F32 => f32::from_bits(u32::from_ne_bytes(word::<BIG, 4>(bytes))),
            _ => self.wide::<BIG>(bytes) as f32,
        }
    }

    /// Reads the value at the start of `bytes` as f64, which represents every value of every type. `BIG` is true for
    /// big-endian bytes.
    #[inline]
    pub(crate) fn wide<const BIG: bool>(self, bytes: &[u8]) -> f64 {
        match self {
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_ne_bytes(word::<BIG, 2>(bytes))),
            Self::U16 => f64::from(u16::from_ne_bytes(word::<BIG, 2>(bytes))),
            Self::I32 => f64::from(i32::from_ne_bytes(word::<BIG, 4>(bytes))),
            Self::U32 => f64::from(u32::from_ne_bytes(word::<BIG, 4>(bytes))),
            Self::F32 => f64::from(f32::from_bits(u32::from_ne_bytes(word::<BIG, 4>(bytes)))),
            Self::F64 => f64::from_bits(u64::from_ne_bytes(word::<BIG, 8>(bytes))),
            Self::F16 => f16::from_bits(u16::from_ne_bytes(word::<BIG, 2>(bytes))).to_f64(),
        }
    }
}

/// Copies the first `N` bytes into the host's byte order.
#[inline]
fn word<const BIG: bool, const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut word = [0; N];
    word.copy_from_slice(&bytes[..N]);
    if BIG != cfg!(target_endian = "big") {
        word.reverse();
    }
    word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scalars_of_every_type_and_both_orders_are_read() {
        assert_eq!(Scalar::F32.value::<false>(&1.5f32.to_le_bytes()), 1.5);
        assert_eq!(Scalar::F32.value::<true>(&1.5f32.to_be_bytes()), 1.5);
        assert_eq!(Scalar::F64.value::<true>(&0.1f64.to_be_bytes()), 0.1);
        assert_eq!(Scalar::I16.value::<false>(&(-7i16).to_le_bytes()), -7.0);
        assert_eq!(Scalar::U16.value::<true>(&40000u16.to_be_bytes()), 40000.0);
        assert_eq!(Scalar::I32.value::<true>(&(-70000i32).to_be_bytes()), -70000.0);
        assert_eq!(Scalar::U32.value::<false>(&4_000_000_000u32.to_le_bytes()), 4e9);
        assert_eq!(Scalar::I8.value::<false>(&[0xFF]), -1.0);
        assert_eq!(Scalar::U8.value::<false>(&[0xFF]), 255.0);
        assert_eq!(Scalar::F16.value::<false>(&[0, 0x3E]), 1.5);
        assert_eq!(Scalar::F32.wide::<true>(&0.1f32.to_be_bytes()), f64::from(0.1f32));
    }
}
