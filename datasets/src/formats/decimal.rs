//! Parsing of decimal numbers in bytes of text, bit-identical to `str::parse`.
//!
//! Digits up to 2^53 and a power of ten up to 10^22 are both exact as f64, so their product or quotient is correctly
//! rounded [Clinger 1990]. `str::parse` reads every other spelling.

/// Number of bytes that must follow a number so that it can be read without bounds checks.
pub(super) const PAD: usize = 8;

/// The powers of ten that are exact.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// The number that begins at `start`, and the position after it; `None` unless it consists of digits, with optional
/// sign, point and exponent, and is exact. The caller checks the character after it.
#[inline(always)]
pub(super) fn number(text: &[u8], start: usize) -> Option<(f64, usize)> {
    let DecimalLiteral { negative, digits, count, exponent, end } = spelt(text, start)?;
    if count > 19 || digits > 1 << 53 {
        return None;
    }
    let whole = digits as f64;
    let size = match exponent {
        0 => whole,
        -22..=-1 => whole / POWERS[exponent.unsigned_abs() as usize],
        1..=22 => whole * POWERS[exponent as usize],
        _ => return None,
    };
    Some((if negative { -size } else { size }, end))
}

/// The position after the decimal number that begins at `start`, which may have any size.
#[inline(always)]
pub(super) fn end(text: &[u8], start: usize) -> Option<usize> {
    spelt(text, start).map(|s| s.end)
}

/// Decimal number as written: sign, digits, exponent and end position.
struct DecimalLiteral {
    negative: bool,
    /// The digits before and after the point; exact up to 19 digits.
    digits: u64,
    count: usize,
    /// Exponent of ten.
    exponent: i64,
    /// The position after the number.
    end: usize,
}

#[inline(always)]
fn spelt(text: &[u8], start: usize) -> Option<DecimalLiteral> {
    let sign = *text.get(start)?;
    let first = start + usize::from(sign == b'-' || sign == b'+');
    let (mut digits, mut end) = run(text, first, 0);
    let (mut count, mut exponent) = (end - first, 0);
    if text.get(end) == Some(&b'.') {
        let point = end + 1;
        (digits, end) = run(text, point, digits);
        count += end - point;
        exponent = -((end - point) as i64);
    }
    if count == 0 {
        return None;
    }
    if matches!(text.get(end), Some(b'e' | b'E')) {
        let sign = text.get(end + 1);
        let first = end + 1 + usize::from(matches!(sign, Some(b'-' | b'+')));
        let (power, after) = run(text, first, 0);
        if after == first {
            return None;
        }
        // Larger powers of ten are not exact.
        let power = if after - first > 9 { i64::from(u32::MAX) } else { power as i64 };
        exponent += if sign == Some(&b'-') { -power } else { power };
        end = after;
    }
    Some(DecimalLiteral { negative: sign == b'-', digits, count, exponent, end })
}

/// Appends the digits at `at` to `value`. Returns the number, and the position after the digits.
#[inline(always)]
fn run(text: &[u8], mut at: usize, mut value: u64) -> (u64, usize) {
    const TENS: [u64; 9] = [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000];
    const HIGH: u64 = 0xF0F0_F0F0_F0F0_F0F0;
    const ZEROS: u64 = 0x3030_3030_3030_3030;
    while let Some(eight) = text.get(at..).and_then(|t| t.first_chunk::<8>()) {
        let word = u64::from_le_bytes(*eight);
        // A byte is a digit if the byte and the byte plus 6 are both in the range 0x30 to 0x3F.
        let other = ((word & HIGH) ^ ZEROS) | ((word.wrapping_add(0x0606_0606_0606_0606) & HIGH) ^ ZEROS);
        let n = (other.trailing_zeros() / 8) as usize;
        if n == 0 {
            return (value, at);
        }
        value = value.wrapping_mul(TENS[n]).wrapping_add(eight_digits(word << (64 - 8 * n)));
        at += n;
        if n < 8 {
            return (value, at);
        }
    }
    while let Some(digit) = text.get(at).map(|b| b.wrapping_sub(b'0')).filter(|d| *d < 10) {
        value = value.wrapping_mul(10).wrapping_add(u64::from(digit));
        at += 1;
    }
    (value, at)
}

/// The number that eight digits form, the first digit in the lowest byte. A zero byte counts as the digit 0.
#[inline(always)]
fn eight_digits(word: u64) -> u64 {
    const EVERY_FOURTH: u64 = 0x0000_00FF_0000_00FF;
    let pairs = (word & 0x0F0F_0F0F_0F0F_0F0F).wrapping_mul(10).wrapping_add((word & 0x0F0F_0F0F_0F0F_0F0F) >> 8);
    let first = (pairs & EVERY_FOURTH).wrapping_mul(100 + (1_000_000 << 32));
    let second = ((pairs >> 16) & EVERY_FOURTH).wrapping_mul(1 + (10_000 << 32));
    first.wrapping_add(second) >> 32
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// Numbers, and strings that resemble numbers, in many spellings.
    pub(in crate::formats) fn spellings() -> Vec<String> {
        let mut all: Vec<String> = [
            "0",
            "-0",
            "+0",
            "-0.0",
            "1",
            "+1",
            "1.",
            ".5",
            "-.5",
            ".",
            "-",
            "+",
            "",
            "e5",
            "1e",
            "1e+",
            "1e5",
            "1E-5",
            "1.e5",
            "1e22",
            "1e23",
            "1e-22",
            "1e-23",
            "9007199254740992",
            "9007199254740993",
            "9007199254740991e22",
            "12345678",
            "123456789",
            "1234567890123456789",
            "12345678901234567890",
            "0.1",
            "0.30000000000000004",
            "2.2250738585072011e-308",
            "5e-324",
            "1.7976931348623157e308",
            "1e400",
            "1e99999999999",
            "1e-99999999999",
            "0e99999999999",
            "00000000000000000000000.5",
            "1_000",
            "1,5",
            "1 2",
            "--1",
            "1-2",
            "1.2.3",
            "nan",
            "inf",
            "0x10",
            "1:30",
            "48123.4567",
            "-22.1234567",
            "140.58012345678901",
            "8.41471e-1",
            "1/2",
            "1;2",
            "12a",
        ]
        .map(str::to_owned)
        .to_vec();
        let mut state = 7_u64;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state >> 11
        };
        for i in 0..60_000 {
            let x = f64::from_bits(next() << 11 ^ next());
            all.push(match i % 4 {
                0 => format!("{x}"),
                1 => format!("{x:e}"),
                2 => {
                    format!("{:.*}", (next() % 18) as usize, (next() as f64 - 4e15) / 10f64.powi((next() % 18) as i32))
                }
                _ => format!("{}.{}e{}", next() % 100_000_000, next() % 1_000_000_000, next() as i64 % 50 - 25),
            });
        }
        all
    }

    #[test]
    fn unit_a_number_is_bit_identical_to_the_standard_librarys() {
        let mut plain = 0;
        for text in spellings() {
            let parsed = text.parse::<f64>().ok();
            for padded in [text.clone(), format!("{text}{}", ",".repeat(PAD))] {
                if let Some((x, _)) = number(padded.as_bytes(), 0).filter(|(_, end)| *end == text.len()) {
                    assert_eq!(Some(x.to_bits()), parsed.map(f64::to_bits), "{text}");
                    plain += 1;
                }
                let all = end(padded.as_bytes(), 0) == Some(text.len());
                let named = parsed.is_some_and(|x| !x.is_finite()) && !text.contains(|c: char| c.is_ascii_digit());
                assert_eq!(all, parsed.is_some() && !named, "{text}");
            }
        }
        assert!(plain > 10_000, "{plain}");
    }
}
