//! Seeded mutation of bytes, strings and JSON.

use serde_json::{Map, Value, json};

/// Parts of hostile names, paths, numbers and strings.
pub const PIECES: [&str; 52] = [
    "..",
    ".",
    "/",
    "//",
    "\\",
    "a",
    "B9",
    "_",
    "-",
    " ",
    "\0",
    "\n",
    "\u{1b}[2J",
    "\u{202e}",
    "C:",
    "con",
    "NUL.txt",
    "~",
    "%2e%2e",
    "\u{ff0e}\u{ff0e}",
    "file:",
    "s3://",
    "$HOME",
    "$mag",
    "\u{e9}",
    "tables",
    "\u{9b}",
    "com1",
    "\"",
    "'",
    "[",
    "]",
    "{",
    "}",
    "=",
    ",",
    "[[",
    "]]",
    "\"\"\"",
    "-1",
    "1e308",
    "nan",
    "inf",
    "18446744073709551615",
    "-9223372036854775808",
    "0.1",
    "1e-300",
    "true",
    "\u{feff}",
    "\r\n",
    "#",
    "\u{10ffff}",
];

/// Deterministic generator: xorshift64 of Marsaglia (2003), from a mixed seed.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random((seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x2545_f491_4f6c_dd1d) | 1)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 16
    }

    /// Number from 0 to `n` - 1; 0 for `n` = 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % (n as u64).max(1)) as usize
    }

    /// Whether an event of probability 1/`n` occurs.
    pub fn chance(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}

/// Start and end of a part of `length` bytes, mostly a short part.
fn range(random: &mut Random, length: usize) -> (usize, usize) {
    let start = random.below(length + 1);
    let longest = if random.chance(4) { length } else { 24 };
    (start, (start + random.below(longest + 1)).min(length))
}

fn line(text: &str, random: &mut Random) -> Vec<u8> {
    let lines: Vec<&str> = text.lines().collect();
    if lines.is_empty() {
        return vec![];
    }
    let start = random.below(lines.len());
    let end = (start + 1 + random.below(6)).min(lines.len());
    format!("\n{}\n", lines[start..end].join("\n")).into_bytes()
}

/// One to four changes of `bytes`; `donors` are strings whose lines may be inserted.
pub fn mutated_text(random: &mut Random, bytes: &[u8], donors: &[&str]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.below(4) {
        let (start, end) = range(random, bytes.len());
        match random.below(9) {
            0 if !bytes.is_empty() => {
                let at = random.below(bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
            1 if !bytes.is_empty() => {
                let at = random.below(bytes.len());
                bytes[at] = *random.pick(&[0, 1, 0x7f, 0x80, 0xff, b'"', b'[', b'9']);
            }
            2 => drop(bytes.drain(start..end)),
            3 => {
                let part = bytes[start..end].to_vec();
                let at = random.below(bytes.len() + 1);
                bytes.splice(at..at, part);
            }
            4 => drop(bytes.splice(start..start, random.pick(&PIECES).bytes())),
            5 => drop(bytes.splice(start..end, random.pick(&PIECES).bytes())),
            6 => {
                let part = if random.chance(2) {
                    random.pick(&PIECES).as_bytes().to_vec()
                } else {
                    bytes[start..end].to_vec()
                };
                let times = (1 << random.below(13)).min(1 + (64 << 10) / part.len().max(1));
                bytes.splice(start..start, part.repeat(times));
            }
            7 => bytes.truncate(start.max(end)),
            _ => {
                let donor: &str = random.pick::<&str>(donors);
                let text = line(donor, random);
                let at = bytes[start..].iter().position(|b| *b == b'\n').map_or(bytes.len(), |n| start + n);
                bytes.splice(at..at, text);
            }
        }
    }
    bytes
}

/// Places of all values of a document.
fn places(value: &Value, at: &str, found: &mut Vec<String>) {
    found.push(at.to_owned());
    match value {
        Value::Array(all) => all.iter().enumerate().for_each(|(i, v)| places(v, &format!("{at}/{i}"), found)),
        Value::Object(all) => all.iter().for_each(|(key, v)| {
            let key = key.replace('~', "~0").replace('/', "~1");
            places(v, &format!("{at}/{key}"), found);
        }),
        _ => {}
    }
}

fn hostile_text(random: &mut Random, old: &str) -> Value {
    match random.below(4) {
        0 => (0..random.below(6)).map(|_| *random.pick(&PIECES)).collect::<String>().into(),
        1 => format!("{old}{}", random.pick(&PIECES)).into(),
        2 => format!("{}{old}", random.pick(&["../", "/", "a/../", "./", "\\", "C:", "../../../../"])).into(),
        _ => String::from_utf8_lossy(&mutated_text(random, old.as_bytes(), &[old])).into_owned().into(),
    }
}

/// Changes one value of a document: its text, its type, or its place.
pub fn mutated_json(random: &mut Random, document: &mut Value) {
    let mut all = vec![];
    places(document, "", &mut all);
    let other = document.pointer(random.pick::<String>(&all)).cloned().unwrap_or(Value::Null);
    let place = random.pick(&all).clone();
    let Some(value) = document.pointer_mut(&place) else { return };
    let new = match (random.below(8), &*value) {
        (0..4, Value::String(old)) => hostile_text(random, &old.clone()),
        (0..4, Value::Number(_)) => {
            let numbers =
                [json!(0), json!(1), json!(-1), json!(u64::MAX), json!(i64::MIN), json!(1e308), json!(0.5), json!(99)];
            random.pick(&numbers).clone()
        }
        (0..4, Value::Array(old)) if !old.is_empty() => {
            let mut new = old.clone();
            let at = random.below(new.len());
            if random.chance(2) {
                new.remove(at);
            } else {
                let copy = new[at].clone();
                new.insert(at, copy);
            }
            new.into()
        }
        (0..4, Value::Object(old)) if !old.is_empty() => {
            let mut new: Map<String, Value> = old.clone();
            let key = old.keys().nth(random.below(old.len())).cloned().unwrap_or_default();
            let moved = new.remove(&key);
            if random.chance(2) {
                new.insert(format!("{key}{}", random.pick(&PIECES)), moved.unwrap_or(Value::Null));
            }
            new.into()
        }
        (4, _) => Value::Null,
        (5, _) => json!([[{"name": "..", "path": "../x"}], true, 1e308]),
        (6, _) => (0..random.below(2000)).fold(other, |inner, _| Value::Array(vec![inner])),
        _ => other,
    };
    *value = new;
}
