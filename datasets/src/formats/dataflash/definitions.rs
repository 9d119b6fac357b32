//! The definitions of messages of a DataFlash log in its FMT, FMTU, UNIT and MULT messages.

use super::super::records::{RecordColumn, RecordFieldType, text};

/// The length of a header: two marks and the type.
pub(super) const HEADER: usize = 3;
/// The type of FMT messages, which define all others and themselves.
pub(super) const FMT: u8 = 0x80;
/// The length of an FMT message.
pub(super) const FMT_LENGTH: u8 = 89;

/// A definition: name, length including the header, and columns with offsets from the end of the header.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MessageDefinition {
    pub(super) name: String,
    pub(super) length: u8,
    /// The columns of the message, one for each element of an array.
    pub(super) columns: Vec<RecordColumn>,
    /// The index of the field of each column, for units.
    pub(super) fields: Vec<usize>,
    /// The format character of each field.
    formats: Vec<u8>,
}

impl MessageDefinition {
    /// The definition in the body of an FMT message, and the type that it defines: type, length, name (4 characters),
    /// format (16), labels (64, between commas). `None` if it is inconsistent.
    pub(super) fn parse(body: &[u8]) -> Option<(u8, MessageDefinition)> {
        let (&[of, length], rest) = body.split_first_chunk::<2>()?;
        let (name, rest) = rest.split_first_chunk::<4>()?;
        let (format, rest) = rest.split_first_chunk::<16>()?;
        let labels = text(rest.first_chunk::<64>()?);
        let (name, format) = (text(name), text(format));
        let labels: Vec<&str> = labels.split(',').map(str::trim).filter(|l| !l.is_empty()).collect();
        let printable = |t: &str| t.bytes().all(|b| b.is_ascii_graphic());
        if name.is_empty() || !printable(&name) || !labels.iter().all(|l| printable(l)) {
            return None;
        }
        // Formats and labels that are too long for their part of the message are truncated, so the fields cannot be
        // identified.
        if labels.len() != format.chars().count() {
            return None;
        }
        let (mut columns, mut fields, mut size) = (vec![], vec![], 0);
        for (i, (character, label)) in format.chars().zip(&labels).enumerate() {
            let FormatCharacter { kind, array, divisor, unit } = FormatCharacter::from_char(character)?;
            let unit = if unit.is_empty() { unit_of(label) } else { unit };
            for k in 0..array.unwrap_or(1) {
                let name = array.map_or_else(|| (*label).to_owned(), |_| format!("{label}[{k}]"));
                columns.push(RecordColumn { name, kind, offset: size, divisor, unit: unit.to_owned() });
                fields.push(i);
                size += kind.bytes();
            }
        }
        let twice = labels.iter().enumerate().any(|(i, l)| labels.iter().take(i).any(|m| m == l));
        if twice || size + HEADER != usize::from(length) {
            return None;
        }
        Some((of, MessageDefinition { name, length, columns, fields, formats: format.into_bytes() }))
    }

    /// The definition of the FMT messages themselves.
    pub(super) fn of_fmt() -> MessageDefinition {
        let column = |(name, kind, offset): (&str, RecordFieldType, usize)| RecordColumn {
            name: name.to_owned(),
            kind,
            offset,
            divisor: 1.0,
            unit: String::new(),
        };
        let columns = [
            ("Type", RecordFieldType::U8, 0),
            ("Length", RecordFieldType::U8, 1),
            ("Name", RecordFieldType::Text(4), 2),
            ("Format", RecordFieldType::Text(16), 6),
            ("Columns", RecordFieldType::Text(64), 22),
        ];
        MessageDefinition {
            name: "FMT".to_owned(),
            length: FMT_LENGTH,
            columns: columns.map(column).to_vec(),
            fields: (0..5).collect(),
            formats: b"BBnNZ".to_vec(),
        }
    }

    /// Whether another definition has the same columns at the same positions.
    pub(super) fn is_like(&self, other: &MessageDefinition) -> bool {
        self.name == other.name && self.length == other.length && self.formats == other.formats && {
            let (ours, theirs) = (self.columns.iter(), other.columns.iter());
            ours.map(|c| &c.name).eq(theirs.map(|c| &c.name))
        }
    }

    /// The column of a field by its label.
    pub(super) fn find(&self, label: &str) -> Option<&RecordColumn> {
        self.columns.iter().find(|c| c.name == label)
    }

    /// The column of the field at an index.
    pub(super) fn field(&self, index: usize) -> Option<&RecordColumn> {
        self.columns.iter().zip(&self.fields).find(|(_, of)| **of == index).map(|(c, _)| c)
    }

    /// Whether the format of a field scales its numbers.
    pub(super) fn is_scaled(&self, index: usize) -> bool {
        self.formats.get(index).is_some_and(|f| b"cCeEL".contains(f))
    }
}

/// The meaning of a format character.
struct FormatCharacter {
    kind: RecordFieldType,
    array: Option<usize>,
    divisor: f64,
    unit: &'static str,
}

impl FormatCharacter {
    /// [ArduPilot, libraries/AP_Logger/LogStructure.h]
    fn from_char(character: char) -> Option<FormatCharacter> {
        let (kind, divisor) = match character {
            'b' | 'M' => (if character == 'M' { RecordFieldType::U8 } else { RecordFieldType::I8 }, 1.0),
            'B' => (RecordFieldType::U8, 1.0),
            'h' => (RecordFieldType::I16, 1.0),
            'H' => (RecordFieldType::U16, 1.0),
            'i' => (RecordFieldType::I32, 1.0),
            'I' => (RecordFieldType::U32, 1.0),
            'q' => (RecordFieldType::I64, 1.0),
            'Q' => (RecordFieldType::U64, 1.0),
            'g' => (RecordFieldType::F16, 1.0),
            'f' => (RecordFieldType::F32, 1.0),
            'd' => (RecordFieldType::F64, 1.0),
            'n' => (RecordFieldType::Text(4), 1.0),
            'N' => (RecordFieldType::Text(16), 1.0),
            'Z' => (RecordFieldType::Text(64), 1.0),
            // Hundredths. Division by 100 gives the floating-point number that is nearest to the decimal value.
            'c' => (RecordFieldType::I16, 1e2),
            'C' => (RecordFieldType::U16, 1e2),
            'e' => (RecordFieldType::I32, 1e2),
            'E' => (RecordFieldType::U32, 1e2),
            // Latitudes and longitudes.
            'L' => (RecordFieldType::I32, 1e7),
            'a' => (RecordFieldType::I16, 1.0),
            _ => return None,
        };
        let array = (character == 'a').then_some(32);
        Some(FormatCharacter { kind, array, divisor, unit: if character == 'L' { "deg" } else { "" } })
    }
}

/// The unit of the time columns, which exist in every log.
fn unit_of(label: &str) -> &'static str {
    match label {
        "TimeUS" | "SampleUS" => "us",
        "TimeMS" => "ms",
        _ => "",
    }
}

/// The units and multipliers of fields.
#[derive(Default)]
pub(super) struct DataflashUnits {
    /// The name of each unit character.
    names: Vec<(u8, String)>,
    /// The factor of each multiplier character.
    factors: Vec<(u8, f64)>,
    /// The unit and multiplier characters of each type.
    of: Vec<(u8, Vec<u8>, Vec<u8>)>,
}

impl DataflashUnits {
    /// Adds the body of a UNIT, MULT or FMTU message.
    pub(super) fn add(&mut self, definition: &MessageDefinition, body: &[u8]) {
        let byte = |label: &str| definition.find(label).and_then(|c| body.get(c.offset)).copied();
        let bytes = |label: &str| {
            let column = definition.find(label)?;
            let bytes = body.get(column.offset..column.offset + column.kind.bytes())?;
            Some(bytes.split(|b| *b == 0).next().unwrap_or_default().to_vec())
        };
        match definition.name.as_str() {
            "UNIT" => {
                if let (Some(id), Some(name)) = (byte("Id"), bytes("Label")) {
                    self.names.retain(|(known, _)| *known != id);
                    self.names.push((id, text(&name)));
                }
            }
            "MULT" => {
                let column = definition.find("Mult").filter(|c| c.kind == RecordFieldType::F64);
                let factor = column.and_then(|c| body.get(c.offset..)?.first_chunk().map(|b| f64::from_le_bytes(*b)));
                if let (Some(id), Some(factor)) = (byte("Id"), factor) {
                    self.factors.retain(|(known, _)| *known != id);
                    self.factors.push((id, factor));
                }
            }
            "FMTU" => {
                if let (Some(of), Some(units)) = (byte("FmtType"), bytes("UnitIds")) {
                    self.of.retain(|(known, ..)| *known != of);
                    self.of.push((of, units, bytes("MultIds").unwrap_or_default()));
                }
            }
            _ => {}
        }
    }

    /// The index of the field that holds the instance, of the unit `#`.
    pub(super) fn instance(&self, of: u8) -> Option<usize> {
        self.of.iter().find(|(known, ..)| *known == of)?.1.iter().position(|u| *u == b'#')
    }

    /// Sets the units of the columns of a type.
    pub(super) fn apply(&self, of: u8, definition: &mut MessageDefinition) {
        let Some((_, units, factors)) = self.of.iter().find(|(known, ..)| *known == of) else { return };
        for i in 0..definition.formats.len() {
            let known = units.get(i).and_then(|id| self.names.iter().find(|(known, _)| known == id));
            let Some(name) = known.map(|(_, name)| usual(name)).filter(|name| !name.is_empty()) else { continue };
            let factor = factors.get(i).and_then(|id| self.factors.iter().find(|(known, _)| known == id));
            // If the format scales its numbers, the factor has already been applied.
            let factor = if definition.is_scaled(i) { 1.0 } else { factor.map_or(1.0, |(_, factor)| *factor) };
            let unit = prefixed(factor, name);
            for (column, _) in definition.columns.iter_mut().zip(&definition.fields).filter(|(_, of)| **of == i) {
                column.unit.clone_from(&unit);
            }
        }
    }
}

/// The converter's spelling of a unit.
fn usual(name: &str) -> &str {
    match name {
        "deglatitude" | "deglongitude" | "degheading" => "deg",
        "Gauss" => "gauss",
        "UNKNOWN" | "instance" => "",
        name => name,
    }
}

/// The unit of logged numbers that a factor converts to `unit`. The numbers are unchanged.
fn prefixed(factor: f64, unit: &str) -> String {
    const PREFIXES: [(f64, &str); 8] =
        [(1.0, ""), (0.0, ""), (1e-1, "d"), (1e-2, "c"), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"), (1e3, "k")];
    // Latitudes in units of 1e-7 degrees have a separate name. Factors are logged in single precision.
    let is = |x: f64| (factor - x).abs() <= 1e-6 * x.abs();
    match PREFIXES.iter().find(|(x, _)| is(*x)) {
        Some((_, prefix)) => format!("{prefix}{unit}"),
        None if is(1e-7) && unit == "deg" => "degE7".to_owned(),
        None => format!("{} {unit}", factor as f32),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn fmt(of: u8, length: u8, name: &str, format: &str, labels: &str) -> Vec<u8> {
        let mut body = vec![of, length];
        for (text, size) in [(name, 4), (format, 16), (labels, 64)] {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(size, 0);
            body.extend(bytes);
        }
        body
    }

    #[test]
    fn ref_every_format_character_has_its_length() {
        // Results of struct.calcsize for the characters of pymavlink.
        let sizes = [
            ("a", 64),
            ("b", 1),
            ("B", 1),
            ("g", 2),
            ("h", 2),
            ("H", 2),
            ("i", 4),
            ("I", 4),
            ("f", 4),
            ("n", 4),
            ("N", 16),
            ("Z", 64),
            ("c", 2),
            ("C", 2),
            ("e", 4),
            ("E", 4),
            ("L", 4),
            ("d", 8),
            ("M", 1),
            ("q", 8),
            ("Q", 8),
        ];
        for (character, size) in sizes {
            let (of, definition) = MessageDefinition::parse(&fmt(7, size + 3, "X", character, "A")).unwrap();
            assert_eq!((of, definition.name.as_str()), (7, "X"), "{character}");
            assert!(MessageDefinition::parse(&fmt(7, size + 4, "X", character, "A")).is_none(), "{character}");
        }
    }

    #[test]
    fn unit_inconsistent_definitions_are_rejected() {
        for body in [
            fmt(7, 5, "X", "BB", "A"),
            fmt(7, 5, "X", "BB", "A,A"),
            fmt(7, 5, "X", "By", "A,B"),
            fmt(7, 6, "X", "BB", "A,B"),
            fmt(7, 5, "", "BB", "A,B"),
            fmt(7, 5, "X", "BB", "A,\u{1}"),
        ] {
            assert!(MessageDefinition::parse(&body).is_none());
        }
        assert!(MessageDefinition::parse(&fmt(7, 5, "X", "BB", "A,B")[..80]).is_none());
    }

    #[test]
    fn unit_fmtu_sets_units_with_multipliers() {
        let (_, unit) = MessageDefinition::parse(&fmt(1, 76, "UNIT", "QbZ", "TimeUS,Id,Label")).unwrap();
        let (_, mult) = MessageDefinition::parse(&fmt(2, 20, "MULT", "Qbd", "TimeUS,Id,Mult")).unwrap();
        let (_, fmtu) =
            MessageDefinition::parse(&fmt(3, 44, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")).unwrap();
        let mut units = DataflashUnits::default();
        for (id, label) in [(b's', "s"), (b'G', "Gauss"), (b'D', "deglatitude"), (b'#', "instance")] {
            let mut body = vec![0; 8];
            body.push(id);
            body.extend(label.as_bytes());
            body.resize(73, 0);
            units.add(&unit, &body);
        }
        for (id, factor) in [(b'F', 1e-6f32), (b'C', 1e-3), (b'G', 1e-7), (b'-', 0.0)] {
            let body = [&[0; 8][..], &[id], &f64::from(factor).to_le_bytes()].concat();
            units.add(&mult, &body);
        }
        let mut of = [&[0; 8][..], &[9], b"s#GD", &[0; 12], b"F-CG", &[0; 12]].concat();
        units.add(&fmtu, &of);
        let (_, mut mag) = MessageDefinition::parse(&fmt(9, 18, "MAG", "QBhL", "TimeUS,I,MagX,Lat")).unwrap();
        units.apply(9, &mut mag);
        let found: Vec<&str> = mag.columns.iter().map(|c| c.unit.as_str()).collect();
        assert_eq!((found.as_slice(), units.instance(9)), (["us", "", "mgauss", "deg"].as_slice(), Some(1)));
        assert!(found.iter().filter(|u| !u.is_empty()).all(|u| schemas::is_unit(u)));
        of[8] = 10;
        units.add(&fmtu, &of);
        assert_eq!((units.instance(10), units.instance(11)), (Some(1), None));
    }
}
