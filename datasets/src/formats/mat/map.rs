//! Maps of MagNav.jl in MATLAB files: a structure `map_data`, or the variables of the file; the module `map_magnav`
//! describes the arrays. `get_map` of MagNav.jl reads the structure.

use std::path::Path;

use super::{
    super::{
        FileHead, MapFormat, MapOptions,
        map_magnav::{self, MagnavArray, MagnavSource},
    },
    V5, is_v73,
    tree::{MatContents, MatValue, MatVariable},
};
use crate::{ReadError, table::ColumnValues};
use grids::AnomalyGrid;

pub(in super::super) const FORMAT: MapFormat = MapFormat {
    name: "magnav_mat",
    about: "map of MagNav.jl in MATLAB 5 to 7.3: a structure with `map`, `xx`, `yy` and `alt`",
    extensions: &["mat"],
    recognise: |head: &FileHead| head.starts_with(V5) || is_v73(head),
    companions: None,
    read,
    write: None,
};

/// The structure that MagNav.jl reads by default.
const MAP_DATA: &str = "map_data";

/// The arrays of a structure.
struct MatMap<'a> {
    path: &'a Path,
    fields: Vec<MatVariable>,
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let MatContents { nodes, notes } = super::read(path, &|_| true)?;
    if let Some(damage) = notes.into_iter().next() {
        return Err(ReadError::data(path, damage));
    }
    let map = MatMap { path, fields: fields(path, nodes)? };
    map_magnav::read(path, options, &map, Vec::new)
}

/// The arrays of the only map in a file; if there are several maps, those of `map_data`.
fn fields(path: &Path, nodes: Vec<MatVariable>) -> Result<Vec<MatVariable>, ReadError> {
    if map_magnav::is_map(|name| nodes.iter().any(|node| node.name == name)) {
        return Ok(nodes);
    }
    let mut maps: Vec<(String, Vec<MatVariable>)> = vec![];
    for MatVariable { name, content } in nodes {
        if let MatValue::Struct(fields) = content
            && map_magnav::is_map(|name| fields.iter().any(|field| field.name == name))
        {
            maps.push((name, fields));
        }
    }
    let chosen = if maps.len() == 1 { Some(0) } else { maps.iter().position(|(name, _)| name == MAP_DATA) };
    if let Some(chosen) = chosen {
        return Ok(maps.swap_remove(chosen).1);
    }
    let names: Vec<&str> = maps.iter().map(|(name, _)| name.as_str()).collect();
    let what = match maps.is_empty() {
        true => "the file holds no map".to_owned(),
        false => format!("the file holds several maps: {}", names.join(", ")),
    };
    let help = "write one structure `map_data` with the fields `map`, `xx`, `yy` and `alt`";
    Err(ReadError::data(path, what).help(help))
}

impl MagnavSource for MatMap<'_> {
    fn has(&self, name: &str) -> bool {
        let skipped = |node: &MatVariable| matches!(node.content, MatValue::Skipped("empty"));
        self.fields.iter().any(|node| node.name == name && !skipped(node))
    }

    fn array(&self, name: &str) -> Result<MagnavArray, ReadError> {
        let wrong = |what: String| Err(ReadError::data(self.path, what).in_column(name));
        let field = self.fields.iter().find(|field| field.name == name);
        let (rows, columns, values) = match field.map(|field| &field.content) {
            Some(MatValue::Array { rows, columns, values: Some(values) }) => (*rows, *columns, values),
            Some(MatValue::Skipped(why)) => return wrong(format!("must be a matrix of numbers, not {why}")),
            Some(_) => return wrong("must be a matrix of numbers".to_owned()),
            None => return wrong(format!("the map has no field `{name}`")),
        };
        let numbers = match values {
            ColumnValues::Number(numbers) => numbers.clone(),
            ColumnValues::Whole(whole) => whole.iter().map(|n| n.map_or(f64::NAN, |n| n as f64)).collect(),
            ColumnValues::Text(_) => return wrong("must be a matrix of numbers, not text".to_owned()),
        };
        // Numbers are stored column by column, that is, with the longitudes first.
        let shape = usize::try_from(columns).ok().zip(usize::try_from(rows).ok()).map(Into::into);
        Ok(MagnavArray::by_longitude(shape, numbers))
    }
}
