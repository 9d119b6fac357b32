//! The files next to a raster in which GDAL stores data that the format cannot hold: `.aux.xml` (no-data value, scale
//! and offset, unit) and `.msk` (a mask of unknown nodes). [GDAL, "PAM", "External mask band"]

use std::path::{Path, PathBuf};

use super::geotiff_band;
use crate::{ReadError, grid::is_marker};

/// The contents of a map's side files.
#[derive(Debug, Default)]
pub(crate) struct SideFiles {
    no_data: Option<f64>,
    packing: [Option<f64>; 2],
    /// The unit of the values.
    pub(crate) unit: Option<String>,
    /// Whether each cell is known, beginning with the first row of the raster.
    mask: Option<Vec<bool>>,
    /// The number of columns.
    width: usize,
}

/// The side files of a map that exist.
pub(super) fn existing(path: &Path) -> Vec<PathBuf> {
    let companion = |ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    [".aux.xml", ".msk"].into_iter().map(companion).filter(|p| p.is_file()).collect()
}

/// Rejects an output path with side files of another map, which would be applied to the new map.
///
/// # Errors
/// Fails if there is such a file.
pub(super) fn refuse_stale(path: &Path) -> Result<(), ReadError> {
    let stale = existing(path).into_iter().next();
    stale.map_or(Ok(()), |side| {
        let what = format!("`{}` belongs to an earlier file, but would be applied to the new file", side.display());
        Err(ReadError::options(path, what).help("remove the earlier file, or choose another output name"))
    })
}

impl SideFiles {
    /// Reads the side files of a map of this size; `None` if there are none.
    ///
    /// # Errors
    /// Fails for a side file that cannot be read, or a mask of another size.
    pub(crate) fn read(path: &Path, width: usize, height: usize) -> Result<Option<SideFiles>, ReadError> {
        let files = existing(path);
        let mut side = SideFiles { width, ..SideFiles::default() };
        for file in &files {
            if file.extension().is_some_and(|e| e == "msk") {
                side.mask = Some(geotiff_band::mask_of(file, width, height)?);
            } else {
                side.describe(file)?;
            }
        }
        Ok((!files.is_empty()).then_some(side))
    }

    fn describe(&mut self, file: &Path) -> Result<(), ReadError> {
        let text = std::fs::read_to_string(file).map_err(|e| ReadError::io(file, &e))?;
        let Some((_, band)) = text.split_once("<PAMRasterBand band=\"1\"") else { return Ok(()) };
        let band = band.split("</PAMRasterBand>").next().unwrap_or_default();
        let content = |name: &str| {
            let (_, rest) = band.split_once(&format!("<{name}"))?;
            let text = rest.strip_prefix('>').or_else(|| rest.strip_prefix(' ')?.split_once('>').map(|(_, t)| t))?;
            text.split('<').next().map(str::trim).filter(|t| !t.is_empty())
        };
        let number = |name: &str| {
            let one = |text: &str| {
                let number = text.parse::<f64>().ok();
                number.ok_or_else(|| ReadError::data(file, format!("`{text}` of `{name}` is not a number")))
            };
            content(name).map(one).transpose()
        };
        self.no_data = number("NoDataValue")?;
        self.packing = [number("Scale")?, number("Offset")?];
        self.unit = content("UnitType").map(str::to_owned);
        Ok(())
    }

    /// Masks the stored values and determines their packing. With `reversed`, the last row of `values` is the first row
    /// of the raster.
    ///
    /// # Errors
    /// Fails for a packing that contradicts the packing in the map's file.
    pub(crate) fn apply(
        &self,
        path: &Path,
        values: &mut [f64],
        packing: &mut [f64; 2],
        reversed: bool,
        notes: &mut Vec<String>,
    ) -> Result<(), ReadError> {
        if let Some(no_data) = self.no_data {
            values.iter_mut().filter(|v| is_marker(**v, no_data)).for_each(|v| *v = f64::NAN);
            notes.push(format!("the no-data value {no_data} of the `.aux.xml` file is applied"));
        }
        if let Some(mask) = &self.mask {
            let (width, height) = (self.width.max(1), values.len() / self.width.max(1));
            for (i, value) in values.iter_mut().enumerate() {
                let (row, column) = (i / width, i % width);
                let row = if reversed { height - 1 - row } else { row };
                if !mask.get(row * width + column).copied().unwrap_or(true) {
                    *value = f64::NAN;
                }
            }
            notes.push("the mask of the `.msk` file is applied".to_owned());
        }
        for (own, (declared, plain)) in packing.iter_mut().zip(self.packing.iter().zip([1.0, 0.0])) {
            match declared {
                Some(declared) if *own == plain => *own = *declared,
                Some(declared) if declared != own => {
                    let what =
                        format!("the `.aux.xml` file has {declared} as scale or offset, but the raster has {own}");
                    return Err(ReadError::data(path, what).help("correct or remove the wrong value"));
                }
                _ => {}
            }
        }
        Ok(())
    }
}
