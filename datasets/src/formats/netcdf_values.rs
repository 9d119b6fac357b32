//! Storage of the numbers of a NetCDF variable: their sign, markers of missing values, valid range, scale and offset.
//! [CF conventions 1.7, 2.5 and 8.1; NetCDF Users' Guide, "Attribute Conventions"]

use std::{collections::BTreeMap, path::Path};

use netcdf_reader::{NcAttrValue, NcType, NcVariable};

use crate::{
    ReadError,
    grid::{PLAIN, is_marker},
};

/// Encoding of the numbers of a variable: sign, missing values, valid range, scale and offset.
pub(super) struct NetcdfEncoding {
    kind: NcType,
    /// Number that corrects the sign if `_Unsigned` contradicts the stored type: it is added to negative values, or
    /// subtracted from values in the upper half of the range.
    modulus: Option<f64>,
    missing: Vec<f64>,
    /// Minimum and maximum valid stored number.
    valid: [f64; 2],
    /// Minimum and maximum valid unpacked value.
    valid_unpacked: [f64; 2],
    /// Scale and offset.
    pub(super) packing: [f64; 2],
}

const ANYTHING: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// An attribute.
pub(super) enum NetcdfAttribute {
    /// Numbers, and whether their type is floating-point.
    Numbers(Vec<f64>, bool),
    Text(String),
}

impl NetcdfAttribute {
    fn from_netcdf(value: &NcAttrValue) -> NetcdfAttribute {
        let real = matches!(value, NcAttrValue::Floats(_) | NcAttrValue::Doubles(_));
        let numbers = value.as_f64_vec().map(|numbers| NetcdfAttribute::Numbers(numbers, real));
        numbers.unwrap_or_else(|| NetcdfAttribute::Text(value.as_string().unwrap_or_default()))
    }
}

/// The names of the attributes that describe the encoding.
pub(super) const ATTRIBUTES: [&str; 8] =
    ["_FillValue", "missing_value", "scale_factor", "add_offset", "valid_min", "valid_max", "valid_range", "_Unsigned"];

impl NetcdfEncoding {
    /// The encoding of a NetCDF variable.
    ///
    /// # Errors
    /// Fails in the cases of [`NetcdfEncoding::from_attributes`].
    pub(super) fn of_variable(path: &Path, variable: &NcVariable) -> Result<NetcdfEncoding, ReadError> {
        let read =
            |name: &&str| Some(((*name).to_owned(), NetcdfAttribute::from_netcdf(&variable.attribute(name)?.value)));
        let all = ATTRIBUTES.iter().filter_map(read).collect();
        NetcdfEncoding::from_attributes(path, variable.name(), variable.dtype().clone(), &all, true)
    }

    /// The encoding that the attributes of a variable describe, among [`ATTRIBUTES`]. With `filled`, NetCDF's default
    /// fill value also marks missing values.
    ///
    /// # Errors
    /// Fails for an attribute that is not a number, or a valid range without exactly two numbers.
    pub(super) fn from_attributes(
        path: &Path,
        variable: &str,
        kind: NcType,
        attributes: &BTreeMap<String, NetcdfAttribute>,
        filled: bool,
    ) -> Result<NetcdfEncoding, ReadError> {
        let attributes = NetcdfAttributes { path, variable, all: attributes };
        let modulus = attributes.modulus(&kind)?;
        let stored = |x: &f64| in_type(&kind, modulus, *x);
        let numbers = |name: &str| attributes.numbers(name).map(|all| all.unwrap_or_default());
        let own_fill = numbers("_FillValue")?;
        let mut missing: Vec<f64> =
            own_fill.iter().chain(&numbers("missing_value")?).map(stored).filter(|x| !x.is_nan()).collect();
        if filled && own_fill.is_empty() && modulus.is_none() {
            missing.extend(default_fill(&kind));
        }
        let packing =
            [attributes.number("scale_factor")?.unwrap_or(1.0), attributes.number("add_offset")?.unwrap_or(0.0)];
        let (mut valid, mut valid_unpacked) = (ANYTHING, ANYTHING);
        let mut bound = |name: &str, which: usize, limit: f64| {
            // A floating-point range of packed integers applies to the unpacked values.
            match packing != PLAIN && is_whole(&kind) && attributes.is_real(name) {
                true => valid_unpacked[which] = limit,
                false => valid[which] = in_type(&kind, modulus, limit),
            }
        };
        for (which, name) in ["valid_min", "valid_max"].into_iter().enumerate() {
            if let Some(limit) = attributes.number(name)? {
                bound(name, which, limit);
            }
        }
        match numbers("valid_range")?.as_slice() {
            [] => {}
            [low, high] => [low, high].iter().enumerate().for_each(|(which, x)| bound("valid_range", which, **x)),
            other => {
                let what = format!("`valid_range` must have two numbers, not {}", other.len());
                return Err(ReadError::data(path, what).in_column(variable));
            }
        }
        Ok(NetcdfEncoding { kind, modulus, missing, valid, valid_unpacked, packing })
    }

    /// Returns the unpacked values of a coordinate variable, with the correct sign. Missing values are not detected.
    pub(super) fn unpacked(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let [scale, offset] = self.packing;
        values.map(|v| self.signed(v) * scale + offset).collect()
    }

    /// The stored numbers, NaN where missing or invalid. A note counts the invalid numbers.
    pub(super) fn known(&self, values: impl Iterator<Item = f64>, notes: &mut Vec<String>) -> Vec<f64> {
        let [scale, offset] = self.packing;
        let within = |x: f64, [low, high]: [f64; 2]| low <= x && x <= high;
        let mut invalid = 0_usize;
        let one = |v: f64| {
            let v = self.signed(v);
            if v.is_nan() || self.is_missing(v) {
                return f64::NAN;
            }
            if within(v, self.valid) && within(v * scale + offset, self.valid_unpacked) {
                return v;
            }
            invalid += 1;
            f64::NAN
        };
        let known = values.map(one).collect();
        if invalid > 0 {
            notes.push(format!("{invalid} values outside the valid range given in the file are treated as unknown"));
        }
        known
    }

    fn signed(&self, v: f64) -> f64 {
        signed(self.modulus, &self.kind, v)
    }

    fn is_missing(&self, v: f64) -> bool {
        match is_whole(&self.kind) {
            true => self.missing.contains(&v),
            false => self.missing.iter().any(|m| is_marker(v, *m)),
        }
    }
}

struct NetcdfAttributes<'a> {
    path: &'a Path,
    variable: &'a str,
    all: &'a BTreeMap<String, NetcdfAttribute>,
}

impl NetcdfAttributes<'_> {
    fn get(&self, name: &str) -> Option<&NetcdfAttribute> {
        self.all.get(name)
    }

    fn wrong(&self, what: String) -> ReadError {
        ReadError::data(self.path, what).in_column(self.variable).help("correct the attribute")
    }

    /// The numbers of an attribute, which may be stored as text.
    fn numbers(&self, name: &str) -> Result<Option<Vec<f64>>, ReadError> {
        let text = match self.get(name) {
            None => return Ok(None),
            Some(NetcdfAttribute::Numbers(numbers, _)) => return Ok(Some(numbers.clone())),
            Some(NetcdfAttribute::Text(text)) => text,
        };
        let words = text.split([',', ' ', '\0']).filter(|w| !w.is_empty());
        let numbers = words.map(|w| w.trim_end_matches(['f', 'd', 's', 'b', 'L']).parse().ok()).collect();
        let numbers: Option<Vec<f64>> = numbers;
        numbers.map(Some).ok_or_else(|| self.wrong(format!("`{name}` must be a number, not `{text}`")))
    }

    fn number(&self, name: &str) -> Result<Option<f64>, ReadError> {
        match self.numbers(name)?.as_deref() {
            None | Some([]) => Ok(None),
            Some([number]) if !number.is_nan() => Ok(Some(*number)),
            Some(other) => Err(self.wrong(format!("`{name}` must be one number, not {other:?}"))),
        }
    }

    fn is_real(&self, name: &str) -> bool {
        matches!(self.get(name), Some(NetcdfAttribute::Numbers(_, true)))
    }

    /// Two to the power of the number of bits, for an integer type whose sign `_Unsigned` contradicts.
    fn modulus(&self, kind: &NcType) -> Result<Option<f64>, ReadError> {
        let unsigned = match self.get("_Unsigned") {
            None => return Ok(None),
            Some(NetcdfAttribute::Numbers(numbers, _)) => match numbers.as_slice() {
                [number] => *number != 0.0,
                other => return Err(self.wrong(format!("`_Unsigned` must be true or false, not {other:?}"))),
            },
            Some(NetcdfAttribute::Text(text)) => match text.trim_matches(['\0', ' ']).to_ascii_lowercase().as_str() {
                "true" => true,
                "false" => false,
                text => return Err(self.wrong(format!("`_Unsigned` must be true or false, not `{text}`"))),
            },
        };
        Ok(bits(kind).filter(|_| unsigned != is_unsigned(kind)).map(|bits| 2_f64.powi(bits)))
    }
}

/// The number of bits of an integer type.
fn bits(kind: &NcType) -> Option<i32> {
    Some(match kind {
        NcType::Byte | NcType::UByte => 8,
        NcType::Short | NcType::UShort => 16,
        NcType::Int | NcType::UInt => 32,
        NcType::Int64 | NcType::UInt64 => 64,
        _ => return None,
    })
}

fn is_whole(kind: &NcType) -> bool {
    bits(kind).is_some()
}

fn is_unsigned(kind: &NcType) -> bool {
    matches!(kind, NcType::UByte | NcType::UShort | NcType::UInt | NcType::UInt64)
}

fn signed(modulus: Option<f64>, kind: &NcType, v: f64) -> f64 {
    match modulus {
        Some(modulus) if !is_unsigned(kind) && v < 0.0 => v + modulus,
        Some(modulus) if is_unsigned(kind) && v >= 0.5 * modulus => v - modulus,
        _ => v,
    }
}

/// A number of an attribute, converted to the type of the variable.
fn in_type(kind: &NcType, modulus: Option<f64>, x: f64) -> f64 {
    let x = if matches!(kind, NcType::Float) { f64::from(x as f32) } else { x };
    signed(modulus, kind, x)
}

/// The default fill value of NetCDF; bytes have no such value.
fn default_fill(kind: &NcType) -> Option<f64> {
    Some(match kind {
        NcType::Short => -32_767.0,
        NcType::UShort => 65_535.0,
        NcType::Int => -2_147_483_647.0,
        NcType::UInt => 4_294_967_295.0,
        NcType::Int64 => -9_223_372_036_854_775_806.0,
        NcType::UInt64 => 18_446_744_073_709_551_614.0,
        NcType::Float | NcType::Double => 9.969_209_968_386_869e36,
        _ => return None,
    })
}
