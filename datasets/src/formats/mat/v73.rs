//! MATLAB 7.3: an HDF5 file after a header of 512 bytes. A structure is a group; a matrix is a data set with reversed
//! dimensions. [MathWorks, MAT-File Versions]

use std::path::Path;

use super::{
    super::hdf5::Hdf5,
    tree::{Content, Node, Read},
};
use crate::{ReadError, table::Values};

/// Maximum nesting of structures.
const DEPTH: usize = 16;

/// Reads the variables of a file: the numbers of those that `keep` names, and only the shapes of others.
///
/// # Errors
/// Fails for an incomplete file.
pub(super) fn read(path: &Path, keep: &dyn Fn(&str) -> bool) -> Result<Read, ReadError> {
    Ok(Read { nodes: nodes(&Hdf5::open(path)?, DEPTH, keep)?, notes: vec![] })
}

fn nodes(file: &Hdf5, depth: usize, keep: &dyn Fn(&str) -> bool) -> Result<Vec<Node>, ReadError> {
    let mut nodes = vec![];
    for name in file.names() {
        nodes.push(Node { name: name.clone(), content: content(file, name, keep(name))? });
    }
    // `#refs#` and `#subsystem#` hold the contents of cells and objects.
    for name in file.groups().iter().filter(|name| !name.starts_with('#')) {
        let kept = keep(name);
        let content = match depth.checked_sub(1) {
            Some(depth) => structure(&file.group(name)?, depth, kept)?,
            None => Content::Skipped("a structure that is nested too deeply"),
        };
        nodes.push(Node { name: name.clone(), content });
    }
    Ok(nodes)
}

fn structure(file: &Hdf5, depth: usize, kept: bool) -> Result<Content, ReadError> {
    if file.has_attribute("MATLAB_sparse") {
        return Ok(Content::Skipped("a sparse matrix"));
    }
    Ok(Content::Struct(nodes(file, depth, &|_| kept)?))
}

/// The classes of numbers; writers other than MATLAB may omit the class.
const NUMBERS: [&str; 12] =
    ["double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical", ""];

fn content(file: &Hdf5, name: &str, kept: bool) -> Result<Content, ReadError> {
    let set = file.need(name)?;
    let class = set.text_attribute("MATLAB_class").unwrap_or_default();
    Ok(match class.as_str() {
        "cell" => Content::Skipped("a cell array"),
        "function_handle" => Content::Skipped("a function"),
        _ if set.has_attribute("MATLAB_empty") => Content::Skipped("empty"),
        class if class != "char" && !NUMBERS.contains(&class) => Content::Skipped("an object of a class"),
        _ if !set.is_numeric() => Content::Skipped("neither numbers nor text"),
        _ if set.shape.len() > 2 => Content::Skipped("an array of more than two dimensions"),
        "char" => {
            let (rows, characters) = (set.shape.last().copied().unwrap_or(1) as usize, set.all()?);
            let characters: Vec<u16> = characters.iter().map(|c| *c as u16).collect();
            let row = |r: usize| characters.iter().skip(r).step_by(rows.max(1)).copied().collect::<Vec<u16>>();
            Content::Texts((0..rows).map(|r| String::from_utf16_lossy(&row(r)).trim_end().to_owned()).collect())
        }
        _ => {
            let (rows, columns) = match set.shape.as_slice() {
                [] => (1, 1),
                [n] => (*n, 1),
                [columns, rows, ..] => (*rows, *columns),
            };
            let values = if kept { Some(set.all()?) } else { None };
            // 2^53: beyond it not every whole number is a Float64.
            if set.is_wide() && values.iter().flatten().any(|x| x.abs() >= 9_007_199_254_740_992.0) {
                return Ok(Content::Skipped("whole numbers beyond 2^53"));
            }
            Content::Array { rows, columns, values: values.map(Values::Number) }
        }
    })
}
