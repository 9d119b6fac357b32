//! Geosoft's Grid eXchange File, revision 3: labelled objects, then values as text or packed in base 90.
//! [SEG Gravity and Magnetics Committee, GXF format revision 3.0, 2001]
//!
//! Files are written as text with the name of the coordinate system. The format cannot store the height, which is
//! omitted.

use std::{collections::BTreeMap, io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{level_m, nodes, numbers, range, text_of, transposed, write_rows},
    limits::DecodeLimit,
    map_esri::unused,
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{AxisUnit, FileAxis, FileCrs, MapDraft, is_marker},
};
use grids::{AnomalyGrid, epsg_of_name};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "gxf",
    about: "Geosoft Grid eXchange File, revision 3",
    extensions: &["gxf"],
    recognise: |head: &FileHead| {
        let text = String::from_utf8_lossy(&head.bytes);
        text.lines().any(|l| l.starts_with("#POINTS") || l.starts_with("#PTSEP") || l.starts_with("#GTYPE"))
    },
    companions: None,
    read,
    write: Some(write),
};

/// The labels and their values; the first four letters identify a label.
struct GxfObjects<'a> {
    path: &'a Path,
    values: BTreeMap<String, Vec<&'a str>>,
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let text = text_of(path)?;
    let (objects, grid) = GxfObjects::parse(path, &text)?;
    if objects.number("ROTA", 0.0)? != 0.0 {
        return Err(ReadError::data(path, "the grid is rotated").help("warp the grid to north-up first"));
    }
    let packed = objects.number("GTYP", 0.0)? as usize;
    let bytes = text.len() as u64 + 1;
    // In a packed grid, a run of any length takes a few bytes, so the size of the text does not limit the number of
    // values.
    let bytes = if packed == 0 { bytes } else { DecodeLimit::new(bytes).most() / 8 };
    let (points, lines) = (objects.number("POIN", f64::NAN)?, objects.number("ROWS", f64::NAN)?);
    let (points, lines) = nodes(path, points as i64, lines as i64, if packed == 0 { 2 } else { 1 }, bytes)?;
    let values = match packed {
        0 => plain(path, grid, points * lines, objects.text("DUMM"))?,
        digits => unpacked(path, grid, points * lines, digits)?,
    };
    let mut draft = objects.draft(values, points, lines)?;
    draft.packing = objects.transform()?;
    draft.axis_unit = objects.axis_unit()?;
    draft.finish(options)
}

impl<'a> GxfObjects<'a> {
    /// The objects before the values, and the text of the values.
    fn parse(path: &'a Path, text: &'a str) -> Result<(GxfObjects<'a>, &'a str), ReadError> {
        let mut values: BTreeMap<String, Vec<&str>> = BTreeMap::new();
        let mut label = String::new();
        let mut at = 0;
        for line in text.split_inclusive('\n') {
            at += line.len();
            let line = line.trim();
            if let Some(rest) = line.strip_prefix('#').filter(|r| !r.starts_with('#')) {
                let word = rest.split_whitespace().next().unwrap_or_default();
                // A value may follow its label on the same line.
                label = word.chars().take(4).collect::<String>().to_ascii_uppercase();
                let behind = rest.get(word.len()..).unwrap_or_default().trim();
                if label == "MAP_" {
                    label = word.to_ascii_uppercase();
                }
                if label == "GRID" {
                    return Ok((GxfObjects { path, values }, text.get(at..).unwrap_or_default()));
                }
                values.entry(label.clone()).or_default().extend((!behind.is_empty()).then_some(behind));
            } else if line.starts_with('#') {
                label.clear();
            } else if !line.is_empty() && !label.is_empty() {
                values.entry(label.clone()).or_default().push(line);
            }
        }
        Err(ReadError::data(path, "the file is truncated: it has no #GRID"))
    }

    fn text(&self, label: &str) -> Option<&'a str> {
        self.values.get(label)?.first().copied()
    }

    fn number(&self, label: &str, default: f64) -> Result<f64, ReadError> {
        let Some(text) = self.text(label) else {
            let what = format!("the file lacks #{label}");
            return if default.is_nan() { Err(ReadError::data(self.path, what)) } else { Ok(default) };
        };
        let word = text.split([' ', ',', '\t']).next().unwrap_or_default().trim_matches('"');
        let number = word.parse::<f64>().ok().filter(|x| x.is_finite());
        number.ok_or_else(|| ReadError::data(self.path, format!("`{word}` of #{label} is not a number")))
    }

    /// Scale and offset of the values.
    fn transform(&self) -> Result<[f64; 2], ReadError> {
        let scale = self.number("TRAN", 1.0)?;
        let words = self.text("TRAN").unwrap_or_default();
        let second = words.split([' ', ',', '\t']).filter(|w| !w.is_empty()).nth(1);
        let offset = second.map_or(Some(0.0), |w| w.parse::<f64>().ok());
        let offset = offset.ok_or_else(|| ReadError::data(self.path, "#TRANSFORM requires a scale and an offset"))?;
        Ok([scale, offset])
    }

    /// The unit of the coordinates: its name and the factor to metres; degrees have no such factor.
    fn axis_unit(&self) -> Result<Option<AxisUnit>, ReadError> {
        let Some(text) = self.text("UNIT") else { return Ok(None) };
        let (name, factor) = text.split_once(',').unwrap_or((text, ""));
        let (name, factor) = (name.trim().trim_matches('"'), factor.trim().parse::<f64>().ok());
        let known = AxisUnit::from_text(name);
        match (known, factor.filter(|m| m.is_finite() && *m > 0.0)) {
            (Some(AxisUnit::Angle(deg)), _) => Ok(Some(AxisUnit::Angle(deg))),
            (_, Some(_)) if name.to_ascii_lowercase().starts_with("deg") => Ok(Some(AxisUnit::Angle(1.0))),
            (Some(AxisUnit::Length(_, metres)), Some(factor)) if (metres / factor - 1.0).abs() > 1e-5 => {
                let what = format!("#UNIT_LENGTH gives the length of the unit `{name}` as {factor} m, which is wrong");
                Err(ReadError::data(self.path, what).help("correct the unit or its length"))
            }
            (_, Some(factor)) => Ok(Some(AxisUnit::Length(name.to_owned(), factor))),
            (Some(unit), None) => Ok(Some(unit)),
            (None, None) => AxisUnit::read(self.path, "UNIT_LENGTH", name),
        }
    }

    /// Rows and columns in the order of `#SENSE`. The origin is the bottom left corner for any order.
    fn draft(&self, values: Vec<f64>, points: usize, lines: usize) -> Result<MapDraft<'a>, ReadError> {
        let sense = self.number("SENS", 1.0)?;
        // Whether the first point is in the east, whether it is in the north, and whether rows run along x.
        let (from_east, from_north, across) = match sense as i64 {
            1 => (false, false, true),
            -1 => (false, false, false),
            2 => (false, true, false),
            -2 => (false, true, true),
            3 => (true, true, true),
            -3 => (true, true, false),
            4 => (true, false, false),
            -4 => (true, false, true),
            _ => return Err(ReadError::data(self.path, format!("#SENSE {sense} is invalid"))),
        };
        let (along, between) = (self.number("PTSE", 1.0)?, self.number("RWSE", 1.0)?);
        let (width, height, dx, dy, values) = match across {
            true => (points, lines, along, between, values),
            false => (lines, points, between, along, transposed(&values, points)),
        };
        let (west, south) = (self.number("XORI", 0.0)?, self.number("YORI", 0.0)?);
        let axis = |name: &str, first: f64, step: f64, len: usize, back: bool| {
            let first = if back { first + step * (len - 1) as f64 } else { first };
            FileAxis::new(self.path, name, first, if back { -step } else { step }, len)
        };
        let x = axis("x", west, dx, width, from_east)?;
        let y = axis("y", south, dy, height, from_north)?;
        let mut draft = MapDraft::new(self.path, x, y, values, self.system());
        if from_east || from_north {
            draft.notes.push(
                "the origin in the file is read as the bottom left corner of the grid, as GXF defines it".to_owned(),
            );
        }
        Ok(draft)
    }

    fn system(&self) -> FileCrs {
        let projection = self.values.get("MAP_PROJECTION").map(Vec::as_slice).unwrap_or_default();
        let name = projection.first().map_or("", |l| l.split('"').nth(1).unwrap_or(l));
        match epsg_of_name(name) {
            Some(code) => FileCrs::Epsg(code),
            None if projection.iter().any(|l| l.to_ascii_lowercase().contains("geographic")) => FileCrs::Unknown,
            None if projection.is_empty() => FileCrs::Unknown,
            None => FileCrs::Projected,
        }
    }
}

fn plain(path: &Path, grid: &str, count: usize, dummy: Option<&str>) -> Result<Vec<f64>, ReadError> {
    let mut words = grid.split_whitespace();
    let values = numbers(path, &mut words, count)?;
    let dummy = dummy.and_then(|d| d.split_whitespace().next()).and_then(|d| d.parse::<f64>().ok());
    let known = |v: f64| if dummy.is_some_and(|dummy| is_marker(v, dummy)) { f64::NAN } else { v };
    Ok(values.into_iter().map(known).collect())
}

/// Unpacks numbers of `digits` base-90 digits each; `%` is the digit 0. `!` marks an unknown value. `"` begins a run:
/// its length and its value follow as packed numbers.
fn unpacked(path: &Path, grid: &str, count: usize, digits: usize) -> Result<Vec<f64>, ReadError> {
    // 90^8 is still exact in double precision.
    if !(1..=8).contains(&digits) {
        return Err(ReadError::data(path, format!("#GTYPE {digits} is invalid")));
    }
    let bytes: Vec<u8> = grid.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    let mut packs = bytes.chunks_exact(digits);
    let broken = |what: String| ReadError::data(path, what);
    let mut values: Vec<f64> = vec![];
    let short = |have: usize| broken(format!("the file is truncated: it has {have} of {count} values"));
    while values.len() < count {
        let pack = packs.next().ok_or_else(|| short(values.len()))?;
        let bad = |pack: &[u8]| broken(format!("`{}` is not a packed number", String::from_utf8_lossy(pack)));
        if !pack.starts_with(b"\"") {
            values.push(base_90(pack).ok_or_else(|| bad(pack))?);
            continue;
        }
        let (run, pack) = (packs.next(), packs.next());
        let (run, pack) = run.zip(pack).ok_or_else(|| short(values.len()))?;
        let run = base_90(run).ok_or_else(|| bad(run))? as usize;
        let value = base_90(pack).ok_or_else(|| bad(pack))?;
        if run > count - values.len() {
            return Err(broken(format!("a run of {run} values is longer than the grid")));
        }
        values.extend(std::iter::repeat_n(value, run));
    }
    Ok(values)
}

/// A packed number: NaN for an unknown value; `None` for text that is not a number.
fn base_90(pack: &[u8]) -> Option<f64> {
    if pack.starts_with(b"!") {
        return Some(f64::NAN);
    }
    pack.iter().try_fold(0.0, |sum, b| (37..=126).contains(b).then(|| sum * 90.0 + f64::from(b - 37)))
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let dummy = unused(&map.anomaly_nt);
    let (least, most) = range(&map.anomaly_nt);
    let kind = if map.is_geographic() { "Geographic" } else { "" };
    let mut head = String::from("! magnetic anomaly, nT\n\n");
    for (label, value) in [
        ("TITLE", "\"magnetic anomaly, nT\"".to_owned()),
        ("POINTS", map.x.len.to_string()),
        ("ROWS", map.y.len.to_string()),
        ("PTSEPARATION", map.x.step.to_string()),
        ("RWSEPARATION", map.y.step.to_string()),
        ("XORIGIN", map.x.first.to_string()),
        ("YORIGIN", map.y.first.to_string()),
        ("ROTATION", "0".to_owned()),
        ("SENSE", "1".to_owned()),
        ("GTYPE", "0".to_owned()),
        ("DUMMY", dummy.to_string()),
        ("ZMINIMUM", least.to_string()),
        ("ZMAXIMUM", most.to_string()),
        ("MAP_PROJECTION", projection(map, kind)),
    ] {
        head.push_str(&format!("#{label}\n{value}\n\n"));
    }
    if !map.is_geographic() {
        let unit = map.crs.unit_m();
        let name = if unit == 1.0 { "m" } else { "unit" };
        head.push_str(&format!("#UNIT_LENGTH\n\"{name}\",{unit}\n\n"));
    }
    head.push_str("#GRID\n");
    let mut sink = outputs.create()?;
    sink.write_all(head.as_bytes()).map_err(|e| outputs.io(&e))?;
    write_rows(outputs, &mut sink, map, false, 4, &dummy.to_string())?;
    outputs.finish(sink)
}

/// The lines of `#MAP_PROJECTION`: the reader recognises the coordinate system by its name.
fn projection(map: &AnomalyGrid, kind: &str) -> String {
    let name = format!("\"{}\"", map.crs.name());
    if kind.is_empty() { name } else { format!("{name}\n\"{}\"\n\"{kind}\"", map.crs.name()) }
}
