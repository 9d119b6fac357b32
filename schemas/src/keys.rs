//! Keys of results: hashes of their inputs, by which results are addressed.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// 128 bits of BLAKE3 over length-prefixed parts.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HashKey([u8; 16]);

impl HashKey {
    /// The key of an ordered list of parts. Parts are length-prefixed, so `["ab"]` and `["a", "b"]` differ.
    pub fn from_parts<P: AsRef<[u8]>>(parts: impl IntoIterator<Item = P>) -> HashKey {
        let mut hasher = blake3::Hasher::new();
        for part in parts {
            let part = part.as_ref();
            hasher.update(&(part.len() as u64).to_le_bytes()).update(part);
        }
        HashKey::finish(&hasher)
    }

    /// The key from the state of `hasher`.
    pub fn finish(hasher: &blake3::Hasher) -> HashKey {
        let mut short = [0; 16];
        short.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        HashKey(short)
    }

    /// The key of these bytes.
    pub fn from_bytes(bytes: [u8; 16]) -> HashKey {
        HashKey(bytes)
    }

    /// The key of `bytes`, without a length prefix. `bytes` must begin with a word that is unique to their use. A
    /// caller that joins parts must separate them.
    pub fn of_bytes(bytes: &[u8]) -> HashKey {
        let mut short = [0; 16];
        short.copy_from_slice(&blake3::hash(bytes).as_bytes()[..16]);
        HashKey(short)
    }

    /// The two 64-bit halves of the key.
    pub fn words(self) -> [u64; 2] {
        let bits = u128::from_le_bytes(self.0);
        [bits as u64, (bits >> 64) as u64]
    }

    /// The key with these two halves, the inverse of [`HashKey::words`].
    pub fn from_words([low, high]: [u64; 2]) -> HashKey {
        HashKey((u128::from(low) | u128::from(high) << 64).to_le_bytes())
    }

    /// Parses a key in the form of [`fmt::Display`].
    pub fn parse(hex: &str) -> Option<HashKey> {
        let mut bytes = [0; 16];
        if hex.len() != 32 || !hex.is_ascii() {
            return None;
        }
        for (i, b) in bytes.iter_mut().enumerate() {
            *b = u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).ok()?;
        }
        Some(HashKey(bytes))
    }
}

impl AsRef<[u8]> for HashKey {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl fmt::Display for HashKey {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

impl Serialize for HashKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for HashKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<HashKey, D::Error> {
        let text = String::deserialize(deserializer)?;
        HashKey::parse(&text).ok_or_else(|| D::Error::custom(format!("`{text}` is not a key of 32 hexadecimal digits")))
    }
}

impl fmt::Debug for HashKey {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{self}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_keys_depend_on_the_boundaries_of_parts() {
        assert_ne!(HashKey::from_parts(["ab"]), HashKey::from_parts(["a", "b"]));
        assert_ne!(HashKey::from_parts(["a", ""]), HashKey::from_parts(["a"]));
        let key = HashKey::from_parts(["x"]);
        assert_eq!(HashKey::parse(&key.to_string()), Some(key));
        assert_eq!(HashKey::parse("xy"), None);
        assert_eq!(HashKey::from_words(key.words()), key);
    }
}
