//! MATLAB 7.3: an HDF5 file after a header of 512 bytes. A structure is a group; a matrix is a data set with reversed
//! dimensions. [MathWorks, MAT-File Versions]

use std::path::Path;

use super::{
    super::hdf5::Hdf5Source,
    tree::{MatContents, MatValue, MatVariable},
};
use crate::{ReadError, table::ColumnValues};

/// Maximum nesting of structures.
const DEPTH: usize = 16;

/// Reads the variables of a file: the numbers of the variables that `keep` selects, and only the shapes of the others.
///
/// # Errors
/// Fails for an incomplete file.
pub(super) fn read(path: &Path, keep: &dyn Fn(&str) -> bool) -> Result<MatContents, ReadError> {
    Ok(MatContents { nodes: nodes(&Hdf5Source::open(path)?, DEPTH, keep)?, notes: vec![] })
}

fn nodes(file: &Hdf5Source, depth: usize, keep: &dyn Fn(&str) -> bool) -> Result<Vec<MatVariable>, ReadError> {
    let mut nodes = vec![];
    for name in file.names() {
        nodes.push(MatVariable { name: name.clone(), content: content(file, name, keep(name))? });
    }
    // `#refs#` and `#subsystem#` hold the contents of cells and objects.
    for name in file.groups().iter().filter(|name| !name.starts_with('#')) {
        let kept = keep(name);
        let content = match depth.checked_sub(1) {
            Some(depth) => structure(&file.group(name)?, depth, kept)?,
            None => MatValue::Skipped("a structure that is nested too deeply"),
        };
        nodes.push(MatVariable { name: name.clone(), content });
    }
    Ok(nodes)
}

fn structure(file: &Hdf5Source, depth: usize, kept: bool) -> Result<MatValue, ReadError> {
    if file.has_attribute("MATLAB_sparse") {
        return Ok(MatValue::Skipped("a sparse matrix"));
    }
    Ok(MatValue::Struct(nodes(file, depth, &|_| kept)?))
}

/// The classes of numbers; writers other than MATLAB may omit the class.
const NUMBERS: [&str; 12] =
    ["double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical", ""];

fn content(file: &Hdf5Source, name: &str, kept: bool) -> Result<MatValue, ReadError> {
    let set = file.need(name)?;
    let class = set.text_attribute("MATLAB_class").unwrap_or_default();
    Ok(match class.as_str() {
        "cell" => MatValue::Skipped("a cell array"),
        "function_handle" => MatValue::Skipped("a function"),
        _ if set.has_attribute("MATLAB_empty") => MatValue::Skipped("empty"),
        class if class != "char" && !NUMBERS.contains(&class) => MatValue::Skipped("an object of a class"),
        _ if !set.is_numeric() => MatValue::Skipped("neither numbers nor text"),
        _ if set.shape.len() > 2 => MatValue::Skipped("an array of more than two dimensions"),
        "char" => {
            let (rows, characters) = (set.shape.last().copied().unwrap_or(1) as usize, set.all()?);
            let characters: Vec<u16> = characters.iter().map(|c| *c as u16).collect();
            let row = |r: usize| characters.iter().skip(r).step_by(rows.max(1)).copied().collect::<Vec<u16>>();
            MatValue::Texts((0..rows).map(|r| String::from_utf16_lossy(&row(r)).trim_end().to_owned()).collect())
        }
        _ => {
            let (rows, columns) = match set.shape.as_slice() {
                [] => (1, 1),
                [n] => (*n, 1),
                [columns, rows, ..] => (*rows, *columns),
            };
            let values = if kept { Some(set.all()?) } else { None };
            // Beyond 2^53, integers may not be exact as Float64.
            if set.is_wide() && values.iter().flatten().any(|x| x.abs() >= 9_007_199_254_740_992.0) {
                return Ok(MatValue::Skipped("whole numbers beyond 2^53"));
            }
            MatValue::Array { rows, columns, values: values.map(ColumnValues::Number) }
        }
    })
}
