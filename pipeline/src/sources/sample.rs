//! The first rows of each file, examined before anything runs.

use std::path::Path;

use arrow_array::RecordBatch;
use datasets::{FlightOptions, open_flight};
use rayon::prelude::*;
use schemas::{Fault, canonical::Canonical};

use super::{
    Flights,
    ingest::runs,
    quality::{Origins, examine},
};

/// Rows of a file that are examined.
const ROWS: usize = 10_000;

impl Flights {
    /// What makes the first 10,000 rows of each file unusable, one fault for each mistake of a file. Simulated flights are
    /// left out, as they would have to be simulated; so is what cannot be read, which is reported where it is read.
    pub fn implausible(&self) -> Vec<Fault> {
        let of = |(path, options): &(std::path::PathBuf, FlightOptions)| first_rows(path, options).unwrap_or_default();
        self.files.par_iter().map(of).collect::<Vec<_>>().into_iter().flatten().collect()
    }
}

fn first_rows(path: &Path, options: &FlightOptions) -> Option<Vec<Fault>> {
    let reader = open_flight(path, options).ok().filter(|r| r.format() != "synth")?;
    let canonical = Canonical::new(reader.schema()).ok()?;
    let origins = Origins::new(reader.schema(), &options.rename);
    let mut found: Vec<Fault> = vec![];
    let mut left = ROWS;
    for batch in reader {
        let batch = batch.ok()?;
        let batch: RecordBatch = batch.slice(0, batch.num_rows().min(left));
        left -= batch.num_rows();
        for (flight, line, part) in runs(&canonical.apply_with_zeros(&batch).ok()?).ok()? {
            let examined = examine(&part, &origins, &options.accept).ok()?;
            for fault in examined.faults {
                // The same column is the same mistake in every line.
                if !found.iter().any(|f| f.place.column == fault.place.column) {
                    found.push(fault.in_line(&flight, &line).in_file(&path.display().to_string()));
                }
            }
        }
        if left == 0 {
            break;
        }
    }
    Some(found)
}
