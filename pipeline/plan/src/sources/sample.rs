//! The first rows of each file, examined before anything runs.

use intake::{
    assemble::LineAssembly,
    quality::{FileColumns, examine},
};
use rayon::prelude::*;
use schemas::{Fault, canonical::FlightConversion};

use super::{Flights, flight_file::FlightFile};

/// Rows of a file that are examined.
const ROWS: usize = 10_000;

impl Flights {
    /// Faults that make lines in the first 10,000 rows of each file unusable, one fault for each mistake in a file.
    /// Skips simulated flights, which would have to be simulated first, and unreadable files, which are reported when
    /// they are read.
    pub fn implausible(&self) -> Vec<Fault> {
        let of = |file: &FlightFile| first_rows(file).unwrap_or_default();
        self.files.par_iter().map(of).collect::<Vec<_>>().into_iter().flatten().collect()
    }
}

fn first_rows(file: &FlightFile) -> Option<Vec<Fault>> {
    let FlightFile { path, options, mapped, made_from, .. } = file;
    if made_from.is_some() {
        return None;
    }
    let mut reader = file.read(1).ok()?;
    let canonical = FlightConversion::new(&reader.schema).ok()?;
    let origins = FileColumns::new(&reader.schema, &options.rename).of_mapping(mapped.is_some());
    let mut assembly = LineAssembly::new(options);
    let mut lines = vec![];
    let mut left = ROWS;
    while left > 0 {
        let Some(part) = reader.next_part() else { break };
        let part = part.ok()?;
        let rows = part.batch.num_rows().min(left);
        left -= rows;
        lines.extend(assembly.add(&canonical.apply_with_zeros(&part.batch.slice(0, rows)).ok()?, &part.faults));
    }
    lines.extend(assembly.finish());
    let mut found: Vec<Fault> = vec![];
    for whole in lines {
        for part in &whole.parts {
            for fault in examine(part, &origins, &options.accept).ok()?.faults {
                // Faults of the same column on several lines are reported once.
                if !found.iter().any(|f| f.place.column == fault.place.column) {
                    found.push(fault.in_line(&whole.flight, &whole.line).in_file(&path.display().to_string()));
                }
            }
        }
    }
    Some(found)
}
