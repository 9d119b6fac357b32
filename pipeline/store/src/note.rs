//! Notes in the store that can be verified: JSON whose first entry is a checksum of the rest. An invalid note is
//! ignored, because all notes can be recomputed.

use schemas::{Fault, keys::HashKey};
use serde::{Serialize, de::DeserializeOwned};

const OPENING: &str = "{\n";

fn first_entry(rest: &str) -> String {
    format!("  \"checksum\": \"{}\",\n", HashKey::from_parts(["note", rest]))
}

/// The text of a note.
///
/// # Errors
/// Fails for a value that is not a JSON object, which is an internal error.
pub fn sealed<T: Serialize>(note: &T) -> Result<Vec<u8>, Fault> {
    let text = serde_json::to_string_pretty(note).map_err(|e| Fault::machine(e.to_string()))?;
    let rest = text.strip_prefix(OPENING).ok_or_else(|| Fault::machine("a note of the store has no entries"))?;
    Ok(format!("{OPENING}{}{rest}", first_entry(rest)).into_bytes())
}

/// Whether a note is intact.
pub fn is_whole(bytes: &[u8]) -> bool {
    unsealed::<serde_json::Value>(bytes).is_some()
}

/// The note in a string, if it is intact.
pub fn unsealed<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let text = std::str::from_utf8(bytes).ok()?.strip_prefix(OPENING)?;
    let (_, rest) = text.split_once('\n')?;
    if text.strip_suffix(rest)? != first_entry(rest) {
        return None;
    }
    serde_json::from_str(&format!("{OPENING}{rest}")).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde::Deserialize;

    use super::*;

    #[derive(Serialize, Deserialize, PartialEq, Debug)]
    struct Note {
        size: u64,
        text: String,
        list: Vec<Option<f64>>,
    }

    #[test]
    fn unit_damaged_notes_are_rejected() {
        let note = Note { size: 7, text: "Übung\n\"{\n".to_owned(), list: vec![Some(0.1), None] };
        let whole = sealed(&note).unwrap();
        assert_eq!(unsealed::<Note>(&whole), Some(note));
        assert!(serde_json::from_slice::<serde_json::Value>(&whole).is_ok(), "it is JSON still");
        for at in 0..whole.len() {
            assert_eq!(unsealed::<Note>(&whole[..at]), None);
            for bit in 0..8 {
                let mut flipped = whole.clone();
                flipped[at] ^= 1 << bit;
                assert_eq!(unsealed::<Note>(&flipped), None, "byte {at}, bit {bit}");
            }
        }
        assert_eq!(unsealed::<Note>(b"{\n  \"size\": 7\n}"), None, "a note without a checksum");
    }
}
