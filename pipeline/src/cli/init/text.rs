//! The text of a spec, with the reason for each choice.

use std::sync::Arc;

use intake::mapping::{Mapping, suggest::quoted};
use results::text::number;
use schemas::one_line;

use super::findings::{LineFinding, LogFindings, TableFindings};

mod vector;

/// Mapping of a log.
pub struct InitSource {
    /// The name of a built-in mapping.
    pub builtin: Option<&'static str>,
    /// The mapping.
    pub mapping: Option<Arc<Mapping>>,
    /// The text of a mapping for this log, which is written next to the spec.
    pub own: Option<String>,
    /// Columns that this mapping does not use.
    pub unused: Vec<String>,
    /// Questions about the mapping.
    pub questions: Vec<String>,
}

/// Contents of a spec.
pub struct InitText<'a> {
    pub name: String,
    /// The path of the log in the spec.
    pub log: String,
    /// The file of the suggested mapping.
    pub mapping: Option<String>,
    pub source: &'a InitSource,
    pub found: &'a LogFindings,
    /// The path of the map in the spec.
    pub map: Option<String>,
    /// Whether the spec navigates on the map.
    pub navigates: bool,
    /// Name and text of the file of lines that is written for a log without a scalar magnetometer.
    pub lines: Option<(String, String)>,
    pub questions: Vec<String>,
}

/// A line has manoeuvres if the direction of the vector magnetometer deviates from its running mean by at least this,
/// as a root mean square, in degrees.
const MANOEUVRE_DEG: f64 = 1.0;
/// Minimum number of samples of a calibration line: the ends are trimmed, and 18 terms are fitted.
const CALIBRATION_ROWS: usize = 200;

impl InitText<'_> {
    /// The main table: the first with a scalar magnetometer, else the first with a vector magnetometer, else the first
    /// table.
    fn main(&self) -> Option<&TableFindings> {
        let all = &self.found.tables;
        let scalar = all.iter().find(|t| !t.scalars.is_empty());
        scalar.or_else(|| all.iter().find(|t| !t.vectors.is_empty())).or_else(|| all.first())
    }

    /// The tables that the spec reads: the main table, and the tables with a vector magnetometer, an attitude or a
    /// position that the main table lacks.
    fn inputs(&self) -> Vec<&TableFindings> {
        let Some(main) = self.main() else { return vec![] };
        let mut chosen = vec![main];
        let needs: [fn(&TableFindings) -> bool; 3] =
            [|t| !t.vectors.is_empty(), |t| t.has("ins_roll") && t.has("ins_yaw"), |t| t.has("lat") && t.has("lon")];
        for need in needs {
            if chosen.iter().any(|t| need(t)) {
                continue;
            }
            // Two tables with a column of the same name cannot be joined.
            let free = |t: &&TableFindings| {
                let shared = |name: &String| {
                    !["tt", "year", "doy"].contains(&name.as_str())
                        && chosen.iter().any(|c| c.columns.contains_key(name))
                };
                need(t) && !t.columns.keys().any(shared)
            };
            if let Some(table) = self.found.tables.iter().find(free) {
                chosen.push(table);
            }
        }
        chosen
    }

    /// The calibration line: the line whose vector magnetometer turns most.
    fn calibration<'a>(&'a self, table: &'a TableFindings) -> Option<(&'a (String, String), &'a LineFinding)> {
        // The changes of direction are known for the lines of the table with a vector magnetometer.
        let table = self.inputs().into_iter().find(|t| !t.vectors.is_empty()).unwrap_or(table);
        let long = table.lines.iter().filter(|(_, l)| l.rows >= CALIBRATION_ROWS);
        let swung = long.filter(|(_, l)| l.swing_deg.is_some_and(|x| x >= MANOEUVRE_DEG));
        swung.max_by(|(_, a), (_, b)| a.swing_deg.unwrap_or(0.0).total_cmp(&b.swing_deg.unwrap_or(0.0)))
    }

    /// The text of the spec.
    pub fn text(&self) -> String {
        let mut text = format!(
            "# Written by `magline init`. The spec runs as it is: magline run SPEC. Lines with `?` need your \
             answer.\n\nname  = {}\nstore = \"store\"   # folder of the results\n",
            quoted(&self.name)
        );
        for question in &self.questions {
            text += &format!("# ? {}\n", one_line(question));
        }
        let inputs = self.inputs();
        let Some(main) = inputs.first() else { return text };
        if self.vector_only().is_some() && self.lines.is_some() {
            text += "\n# The model is calibrated on one half of the log and applied to both.\n[axes]\ncalibration = \
                     [\"1\", \"2\"]\n";
        }
        for table in &inputs {
            text += &self.block(table, inputs.len() > 1);
        }
        if !main.has("year") {
            text += "# ? No date was found, so `core_field` and `navigate` are not possible. Give the date as `date` \
                     in `time` of a mapping.\n";
        }
        if let Some(map) = &self.map {
            text += &format!("\n[tables.anomaly]\npath = {}\n", quoted(map));
        }
        text + &self.stages(main)
    }

    /// The name of a table in the spec.
    fn named(&self, table: &TableFindings, several: bool) -> String {
        if several && !table.name.is_empty() { table.name.clone() } else { "log".to_owned() }
    }

    /// The text that declares a table in the spec.
    fn block(&self, table: &TableFindings, several: bool) -> String {
        let mut text = format!("\n[tables.{}]\npath    = {}\n", self.named(table, several), quoted(&self.log));
        match (&self.mapping, self.source.builtin) {
            (Some(own), _) => {
                text +=
                    &format!("mapping = {}   # columns, units, axes and time; check each `guess` in it\n", quoted(own));
            }
            (None, Some(name)) => {
                text += &format!("mapping = {}   # chosen by the topics and columns of the log\n", quoted(name));
            }
            (None, None) => text += "# No mapping: the columns have the names of the flight table.\n",
        }
        if !table.name.is_empty() {
            text += &format!("table   = {}\n", quoted(&table.name));
        }
        if let Some((file, _)) = self.lines.as_ref().filter(|_| self.vector_only().is_some()) {
            text += &format!("lines   = {}   # two halves of the flight\n", quoted(file));
        }
        for (key, given) in [("flight ", &self.found.flight), ("line   ", &self.found.line)] {
            if let Some(given) = given {
                text += &format!("{key} = {}   # the log has no such column\n", quoted(given));
            }
        }
        text
    }

    fn stages(&self, main: &TableFindings) -> String {
        let rate = main.rate_hz().map_or(10.0, rounded);
        let inputs = self.inputs();
        let names: Vec<String> = inputs.iter().map(|t| quoted(&self.named(t, inputs.len() > 1))).collect();
        let input = if let [one] = names.as_slice() { one.clone() } else { format!("[{}]", names.join(", ")) };
        let mut text = format!(
            "\n# Even times, at the sampling rate of the magnetometer: nothing is aliased.\n[[stages]]\nname    = \
             \"even\"\nstage   = \"resample\"\ninput   = {input}\nrate_hz = {rate:?}\n"
        );
        if rate <= 2.0 {
            text += &format!("max_gap_s = {:?}   # 2.5 samples\n", 2.5 / rate);
        }
        let mut last = "even";
        let Some(mag) = main.scalars.first() else {
            return text + &listed("vector magnetometers", &main.vectors) + &self.vector_stages(main);
        };
        let vectors = inputs.iter().find(|t| !t.vectors.is_empty()).map_or(&[][..], |t| &t.vectors);
        text += &listed("scalar magnetometers", &main.scalars);
        text += &listed("vector magnetometers", vectors);
        let calibration = self.calibration(main);
        if let (Some(vector), Some(((flight, line), found))) = (vectors.first(), calibration) {
            let condition = format!("flight = '{}' and line = '{}'", sql(flight), sql(line));
            let (low, high) = (0.1_f64.min(0.05 * rate), 0.9_f64.min(0.45 * rate));
            text += &format!(
                include_str!("text/scalar_stages.txt"),
                vector = quoted(vector),
                swing_deg = number(found.swing_deg),
                condition = quoted(&condition),
                mag = quoted(mag),
                low = low,
                high = high,
            );
            last = "clean";
        } else {
            text += "# ? No compensation: it requires a vector magnetometer and a line with manoeuvres (roll, pitch \
                     and yaw of some degrees).\n";
        }
        let Some(_) = &self.map else { return text };
        text += &format!(
            "\n# The anomaly of the map at each sample.\n[[stages]]\nname  = \"on_map\"\nstage = \"map_value\"\n\
             input = \"{last}\"\nmap   = \"anomaly\"\n"
        );
        if self.navigates && last == "clean" {
            let others = calibration.filter(|_| main.lines.len() > 1).map(|((_, line), _)| sql(line));
            let condition = others.map_or(String::new(), |line| {
                format!("where = {}   # not the calibration line\n", quoted(&format!("line <> '{line}'")))
            });
            text += &format!(include_str!("text/track_stages.txt"), condition = condition);
        }
        text
    }

    /// The compensation of the spec, in words.
    fn compensation(&self, main: &TableFindings) -> String {
        let vector = self.inputs().into_iter().find_map(|t| t.vectors.first()).cloned();
        match (main.scalars.first(), vector) {
            (Some(mag), Some(vector)) if self.calibration(main).is_some() => {
                format!("{mag} with the Tolles-Lawson terms of {vector}")
            }
            (Some(_), Some(_)) => "none (no line has manoeuvres)".to_owned(),
            (Some(_), None) => "none (compensation requires a vector magnetometer)".to_owned(),
            (None, _) => match self.vector_only() {
                Some(only) => format!("the magnitude of {}, with the core field as the reference", only.vector),
                None => {
                    let needs = self.vector_needs().join(", ");
                    format!("none (without a scalar magnetometer, compensation needs data that the log lacks: {needs})")
                }
            },
        }
    }

    /// The findings and choices, for the terminal.
    pub fn summary(&self) -> String {
        let mut text = format!("{} ({})\n", one_line(&self.log), self.found.format);
        if let Some(name) = self.source.builtin {
            text += &format!("  mapping: {name}, chosen by content\n");
        }
        for table in &self.found.tables {
            let rows: usize = table.lines.values().map(|l| l.rows).sum();
            let name = if table.name.is_empty() { "log" } else { &table.name };
            let columns: Vec<String> = table
                .columns
                .iter()
                .map(|(n, c)| if c.unit.is_empty() { n.clone() } else { format!("{n} [{}]", c.unit) })
                .collect();
            text += &format!(
                "  {name}: {rows} rows, {}, {} Hz\n    {}\n",
                super::super::counted(table.lines.len(), "line"),
                number(table.rate_hz()),
                one_line(&columns.join(", "))
            );
            let idle = table.columns.iter().filter(|(_, c)| c.known > 1 && c.high == c.low).map(|(n, _)| n.clone());
            let idle: Vec<String> = idle.filter(|n| n != "year" && n != "doy").collect();
            if !idle.is_empty() {
                text += &format!("    constant: {}\n", one_line(&idle.join(", ")));
            }
            if table.faults > 0 {
                text += &format!(
                    "    {} unreadable; `magline run` reports them\n",
                    super::super::counted(table.faults, "row")
                );
            }
        }
        if let Some(main) = self.main() {
            let of = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            text += &format!("  scalar magnetometers: {}\n", of(&main.scalars));
            text += &format!("  vector magnetometers: {}\n", of(&main.vectors));
            text += &format!("  compensation: {}\n", self.compensation(main));
            let line = self.calibration(main).map(|((_, line), _)| one_line(line).into_owned());
            text += &format!("  calibration line: {}\n", line.unwrap_or_else(|| "none with manoeuvres".to_owned()));
            text += &format!("  date: {}\n", if main.has("year") { "found" } else { "not found" });
        }
        for column in &self.source.unused {
            text += &format!("  not used: {column}\n");
        }
        for question in &self.questions {
            text += &format!("  ? {}\n", one_line(question));
        }
        text
    }
}

/// Escapes a string for use inside quotes in an SQL condition of a stage, in which `$` begins the name of an axis.
fn sql(text: &str) -> String {
    text.replace('\'', "''").replace('$', "$$")
}

/// A comment that names the chosen candidate and the others.
fn listed(what: &str, names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => format!("# {what}: {one}\n"),
        [first, others @ ..] => format!("# {what}: {first} is used; also found: {}\n", others.join(", ")),
    }
}

/// A rate as a user would write it: a whole number if the rate is within 2 per cent of a whole number, otherwise three
/// digits.
fn rounded(hz: f64) -> f64 {
    let whole = hz.round();
    if whole >= 1.0 && (hz / whole - 1.0).abs() < 0.02 {
        return whole;
    }
    let scale = 10_f64.powf(2.0 - hz.log10().floor());
    (hz * scale).round() / scale
}
