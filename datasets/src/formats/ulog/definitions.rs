//! Formats and subscriptions of a ULog file: the layout of the columns in data messages.

use std::collections::{HashMap, HashSet};

use super::super::records::{RecordColumn, RecordFieldType, text};

/// A field in the declaration of a format.
#[derive(Clone, Debug, PartialEq, Eq)]
struct UlogFieldDeclaration {
    /// A basic type, or the name of another format.
    of: String,
    /// `None` for one value, the length for an array.
    length: Option<usize>,
    name: String,
}

/// The layout of the data messages of a format.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UlogMessageLayout {
    /// The columns, without padding.
    pub(super) columns: Vec<RecordColumn>,
    /// Number of bytes of a message without the padding at its end; a message may lack some or all of the padding.
    pub(super) least: usize,
    /// Number of bytes of a message with the padding at its end.
    pub(super) most: usize,
}

/// The formats of a file, by name.
#[derive(Default)]
pub(super) struct UlogFormats {
    known: HashMap<String, Vec<UlogFieldDeclaration>>,
    /// Names with two different definitions.
    pub(super) contradicted: Vec<String>,
}

/// Maximum nesting of formats; PX4 has two levels.
const DEPTH: usize = 16;
/// Maximum length of a message, which is stored in 16 bits.
const LONGEST: usize = u16::MAX as usize;

impl UlogFormats {
    /// Adds the format of a message `name:type field;type[n] field;`; `None` if it is invalid. A later definition of
    /// the same name replaces the earlier one for subsequent messages.
    pub(super) fn add(&mut self, body: &[u8]) -> Option<()> {
        let (name, fields) = split(body)?;
        if let Some(known) = self.known.insert(name.clone(), fields.clone())
            && known != fields
            && !self.contradicted.contains(&name)
        {
            self.contradicted.push(name);
        }
        Some(())
    }

    /// The layout of a format with the fields of nested formats; `None` if a format is missing, contains itself, has
    /// duplicate fields, is longer than a message, or has more than `most` columns.
    pub(super) fn layout(&self, name: &str, most: usize) -> Option<UlogMessageLayout> {
        let mut flat = UlogColumnBuilder { most, ..UlogColumnBuilder::default() };
        self.flatten(name, "", DEPTH, &mut flat)?;
        let mut names = HashSet::new();
        if !flat.columns.iter().all(|c| names.insert(c.name.as_str())) || flat.size == 0 {
            return None;
        }
        Some(UlogMessageLayout { least: flat.size - flat.padding, most: flat.size, columns: flat.columns })
    }

    fn flatten(&self, name: &str, prefix: &str, depth: usize, to: &mut UlogColumnBuilder) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        for UlogFieldDeclaration { of, length, name } in self.known.get(name)? {
            let padding = name.starts_with("_padding");
            let indices = (0..length.unwrap_or(1)).map(|i| length.map_or(String::new(), |_| format!("[{i}]")));
            match UlogBasicType::from_name(of) {
                Some(UlogBasicType::Char) => {
                    to.push(format!("{prefix}{name}"), RecordFieldType::Text(length.unwrap_or(1)), padding)?
                }
                Some(UlogBasicType::Number(kind)) => {
                    for index in indices {
                        to.push(format!("{prefix}{name}{index}"), kind, padding)?;
                    }
                }
                None => {
                    for index in indices {
                        self.flatten(of, &format!("{prefix}{name}{index}."), depth, to)?;
                    }
                }
            }
        }
        Some(())
    }
}

/// Basic type of a ULog field: a number or a character.
enum UlogBasicType {
    Number(RecordFieldType),
    Char,
}

impl UlogBasicType {
    fn from_name(name: &str) -> Option<UlogBasicType> {
        const NUMBERS: [(&str, RecordFieldType); 11] = [
            ("int8_t", RecordFieldType::I8),
            ("uint8_t", RecordFieldType::U8),
            ("bool", RecordFieldType::U8),
            ("int16_t", RecordFieldType::I16),
            ("uint16_t", RecordFieldType::U16),
            ("int32_t", RecordFieldType::I32),
            ("uint32_t", RecordFieldType::U32),
            ("int64_t", RecordFieldType::I64),
            ("uint64_t", RecordFieldType::U64),
            ("float", RecordFieldType::F32),
            ("double", RecordFieldType::F64),
        ];
        let number = NUMBERS.iter().find(|(known, _)| *known == name).map(|(_, kind)| UlogBasicType::Number(*kind));
        number.or((name == "char").then_some(UlogBasicType::Char))
    }
}

/// Collector of the columns of a format, with nested formats flattened.
#[derive(Default)]
struct UlogColumnBuilder {
    columns: Vec<RecordColumn>,
    /// The maximum number of columns.
    most: usize,
    size: usize,
    /// Number of bytes of padding at the end.
    padding: usize,
}

impl UlogColumnBuilder {
    fn push(&mut self, name: String, kind: RecordFieldType, padding: bool) -> Option<()> {
        let offset = self.size;
        self.size = self.size.checked_add(kind.bytes()).filter(|size| *size <= LONGEST)?;
        // Loggers omit the padding at the end, including the padding of the last nested format.
        self.padding = if padding { self.padding + kind.bytes() } else { 0 };
        if !padding {
            self.most = self.most.checked_sub(1)?;
            let unit = unit(&name).to_owned();
            self.columns.push(RecordColumn { name, kind, offset, divisor: 1.0, unit });
        }
        Some(())
    }
}

/// The unit of a field: microseconds for time stamps, as the format defines; otherwise the unit implied by the names of
/// PX4's messages. [docs.px4.io, ULog File Format; PX4-Autopilot, msg/]
fn unit(name: &str) -> &'static str {
    let name = name.rsplit('.').next().unwrap_or(name);
    let name = name.split('[').next().unwrap_or(name);
    let end = |suffix: &str| name.ends_with(suffix);
    let start = |prefix: &str| name.starts_with(prefix);
    match name {
        "timestamp" | "timestamp_sample" => "us",
        _ if end("_ga") => "gauss",
        _ if end("_m_s2") => "m/s2",
        _ if end("_m_s") => "m/s",
        _ if end("_rad_s") => "rad/s",
        _ if end("_rad") => "rad",
        _ if end("_deg") => "deg",
        _ if start("voltage") && end("_v") => "V",
        _ if start("current") && end("_a") => "A",
        _ if end("_celcius") || end("_celsius") => "degC",
        _ if end("_pa") => "Pa",
        _ if end("_meter") || start("altitude") && end("_m") => "m",
        _ => "",
    }
}

fn split(body: &[u8]) -> Option<(String, Vec<UlogFieldDeclaration>)> {
    let body = text(body);
    let (name, fields) = body.split_once(':')?;
    let fields = fields.split(';').filter(|f| !f.is_empty()).map(declared).collect::<Option<Vec<_>>>()?;
    (is_name(name) && !fields.is_empty()).then(|| (name.to_owned(), fields))
}

fn declared(field: &str) -> Option<UlogFieldDeclaration> {
    let (of, name) = field.split_once(' ')?;
    let (of, length) = match of.split_once('[') {
        None => (of, None),
        // An array longer than a message is invalid.
        Some((of, length)) => (of, Some(length.strip_suffix(']')?.parse().ok().filter(|n| *n <= LONGEST)?)),
    };
    (is_name(of) && is_name(name)).then(|| UlogFieldDeclaration { of: of.to_owned(), length, name: name.to_owned() })
}

/// Whether a string may be the name of a format or field.
pub(super) fn is_name(name: &str) -> bool {
    !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"_-/.".contains(&b))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn formats(all: &[&str]) -> UlogFormats {
        let mut formats = UlogFormats::default();
        all.iter().for_each(|f| formats.add(f.as_bytes()).unwrap());
        formats
    }

    #[test]
    fn ref_fields_of_nested_formats_are_expanded_in_place() {
        let formats = formats(&[
            "esc_report:uint64_t timestamp;int32_t rpm;uint8_t[4] _padding0;",
            "esc_status:uint64_t timestamp;esc_report[2] esc;char[8] name;bool on;uint8_t[7] _padding0;",
        ]);
        let layout = formats.layout("esc_status", 7).unwrap();
        let named: Vec<(&str, usize)> = layout.columns.iter().map(|c| (c.name.as_str(), c.offset)).collect();
        let wanted = [
            ("timestamp", 0),
            ("esc[0].timestamp", 8),
            ("esc[0].rpm", 16),
            ("esc[1].timestamp", 24),
            ("esc[1].rpm", 32),
            ("name", 40),
            ("on", 48),
        ];
        assert_eq!((named.as_slice(), layout.least, layout.most), (wanted.as_slice(), 49, 56));
    }

    #[test]
    fn unit_invalid_formats_have_no_layout() {
        let none = |all: &[&str], name: &str| assert!(formats(all).layout(name, 1 << 20).is_none(), "{all:?}");
        none(&["a:b x;", "b:a y;"], "a");
        none(&["a:b x;"], "a");
        none(&["a:uint8_t[65535] x;uint8_t y;"], "a");
        none(&["a:b[65535] x;", "b:c[65535] x;", "c:uint64_t[65535] x;"], "a");
        none(&["a:uint8_t x;float x;"], "a");
        none(&["a:uint8_t[0] x;"], "a");
        assert!(formats(&["a:uint8_t[9] x;"]).layout("a", 8).is_none());
        for bad in [
            "a",
            "a:",
            ":uint8_t x;",
            "a:uint8_t;",
            "a:uint8_t[-1] x;",
            "a:uint8_t[99999999999999999999] x;",
            "a:uint8_t[2 x;",
        ] {
            assert!(UlogFormats::default().add(bad.as_bytes()).is_none(), "{bad}");
        }
        assert_eq!(formats(&["a:float x;", "a:float x;", "a:double x;"]).contradicted, ["a"]);
    }

    #[test]
    fn ref_units_by_the_naming_of_px4() {
        for (name, of) in [
            ("timestamp", "us"),
            ("magnetometer_ga[2]", "gauss"),
            ("accelerometer_m_s2[0]", "m/s2"),
            ("gyro_rad[1]", "rad"),
            ("current_a", "A"),
            ("voltage_cell_v[3]", "V"),
            ("lat", ""),
            ("esc[0].timestamp", "us"),
            ("delta_a", ""),
        ] {
            assert_eq!(unit(name), of, "{name}");
        }
    }
}
