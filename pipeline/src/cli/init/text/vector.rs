//! The part of a spec for a log without a scalar magnetometer: the vector magnetometer is calibrated against the core
//! field in the body frame.

use super::{InitText, TableFindings, quoted};

/// The two halves of a log are calibrated only if the log is at least this long, in seconds.
const LEAST_S: f64 = 60.0;

/// Data of a log from which a vector magnetometer is calibrated.
pub struct VectorOnly {
    /// The vector magnetometer.
    pub vector: String,
    /// Whether the height is above sea level, in the column `msl`.
    above_sea: bool,
}

impl InitText<'_> {
    /// Calibration of a log without a scalar magnetometer. `None` if the log has a scalar magnetometer, or if
    /// [`vector_needs`](Self::vector_needs) is not empty.
    pub fn vector_only(&self) -> Option<VectorOnly> {
        let inputs = self.inputs();
        let main = inputs.first()?;
        let usable = main.scalars.is_empty() && self.vector_needs().is_empty();
        let vector = main.vectors.first().filter(|_| usable)?.clone();
        Some(VectorOnly { vector, above_sea: !inputs.iter().any(|t| t.has("alt")) })
    }

    /// Data that the calibration of a vector magnetometer needs and the log lacks.
    pub(super) fn vector_needs(&self) -> Vec<&'static str> {
        let inputs = self.inputs();
        let has = |name: &str| inputs.iter().any(|t| t.has(name));
        let vector = inputs.first().is_some_and(|main| !main.vectors.is_empty());
        let needs = [
            (vector, "a vector magnetometer"),
            (["ins_roll", "ins_pitch", "ins_yaw"].into_iter().all(has), "the attitude"),
            (has("lat") && has("lon"), "the position"),
            (has("alt") || has("msl"), "the height"),
            (has("year"), "the date"),
        ];
        needs.into_iter().filter(|(there, _)| !there).map(|(_, need)| need).collect()
    }

    /// Name and text of a table that divides the only line of a log into two halves, without the time on the ground.
    /// `None` for a short log and for a log of several lines.
    pub fn halves(&self, stem: &str) -> Option<(String, String)> {
        self.vector_only()?;
        let inputs = self.inputs();
        let mut lines = inputs.first()?.lines.iter();
        let ((flight, _), line) = lines.next()?;
        // On the ground, the magnetic fields of the engine and of the surroundings differ from those in flight.
        let flying = inputs.iter().find_map(|t| t.lines.values().find_map(|l| l.flying));
        let (begins, ends) = flying.unwrap_or((line.first_tt, line.last_tt));
        let (first, last) = (line.first_tt.max(begins), line.last_tt.min(ends));
        let long = last - first >= LEAST_S;
        if !long || lines.next().is_some() {
            return None;
        }
        // The comma and the quote of a flight name are escaped as in CSV.
        let flight = format!("\"{}\"", flight.replace('"', "\"\""));
        let middle = 0.5 * (first + last);
        let text =
            format!("flight,line,t_start,t_end\n{flight},1,{first:.3},{middle:.3}\n{flight},2,{middle:.3},{last:.3}\n");
        Some((format!("{stem}_lines.csv"), text))
    }

    /// The stages after `even`.
    pub(super) fn vector_stages(&self, main: &TableFindings) -> String {
        let Some(VectorOnly { vector, above_sea }) = self.vector_only() else {
            let needs = self.vector_needs().join(", ");
            let mut text = format!(
                "# ? No scalar magnetometer was found. Compensation without one requires data that the log lacks: \
                 {needs}.\n"
            );
            if let Some(vector) = main.vectors.first() {
                text += &format!(
                    "\n# The magnitude of the vector magnetometer.\n[[stages]]\nname   = \"total\"\nstage  = \
                     \"magnitude\"\ninput  = \"even\"\nvector = {}\n",
                    quoted(vector)
                );
            }
            return text;
        };
        let mut text =
            "\n# There is no scalar magnetometer. The magnitude of the vector magnetometer is compensated, with the \
             core\n# field in the body frame as the reference. Tolles-Lawson terms of the same sensor reproduce its\n\
             # magnitude exactly, so they are not used.\n"
                .to_owned();
        let mut last = "even";
        if above_sea {
            text += "\n# The height is above sea level; the core field needs the height above the ellipsoid. The \
                     difference of at most\n# 110 m changes the core field by at most 4 nT.\n[[stages]]\n\
                     name    = \"height\"\nstage   = \"derive\"\ninput   = \"even\"\ncolumns = { alt = \"msl\" }\n\
                     units   = { alt = \"m\" }\n";
            last = "height";
        }
        let (vector, magnitude) = (quoted(&vector), quoted(&format!("{vector}_t")));
        let (condition, of_half) = if self.lines.is_some() {
            ("where    = \"line = '$calibration'\"\n".to_owned(), "the half of `calibration`")
        } else {
            (String::new(), "all lines; the scores are therefore `in_sample`")
        };
        text += &format!(
            include_str!("vector_stages.txt"),
            last = last,
            vector = vector,
            magnitude = magnitude,
            condition = condition,
            of_half = of_half,
            core = quoted(&format!("core_{}", vector.trim_matches('"'))),
        );
        text
    }
}
