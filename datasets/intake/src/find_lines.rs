//! Detection of lines from the motion of a flight: survey lines and tie lines, calibration boxes, cloverleafs, figures
//! of eight, and circles.
//!
//! A turn is a change of the course to one side by more than a calibration's yaw manoeuvres; the legs between turns are
//! straight. A manoeuvre is a part of a leg where the power of roll, pitch or yaw is far above the power in quiet
//! flight. All limits are relative to typical values of the flight and are not tuned to an aircraft.

mod collect;
mod legs;
mod motion;
mod patterns;
mod picture;
#[cfg(test)]
mod tests;

use std::fmt::Write;

use schemas::Fault;

pub use collect::{ChannelCollector, table};
pub use legs::{FlightSegments, MotionClass};
pub use motion::{AttitudeChannel, FlightChannels, FlightMotion, PositionChannel};
pub use patterns::{DetectedLine, LinePattern};
pub use picture::{png, svg};

/// Version of the detection, increased when the detection gives other lines.
pub const VERSION: &str = "found lines 2";

/// Lines detected in a flight, with its motion and segments.
#[derive(Clone, Debug)]
pub struct LineDetection {
    /// Motion of the flight at evenly spaced times.
    pub motion: FlightMotion,
    /// Segments.
    pub parts: FlightSegments,
    /// Lines, in the order of their times.
    pub lines: Vec<DetectedLine>,
}

impl LineDetection {
    /// Finds the lines of a flight.
    pub fn from_channels(channels: &FlightChannels) -> LineDetection {
        let motion = FlightMotion::from_channels(channels);
        let parts = FlightSegments::from_motion(&motion);
        let lines = patterns::lines(&motion, &parts);
        LineDetection { motion, parts, lines }
    }

    /// First and last time of a line, in seconds past midnight UTC, rounded to 0.1 s so that text holds them exactly.
    pub fn times_s(&self, line: &DetectedLine) -> (f64, f64) {
        let at = |row: usize| self.motion.tt_s.get(row).map_or(f64::NAN, |t| (10.0 * t).round() / 10.0);
        (at(line.rows.start), at(line.rows.end.saturating_sub(1)))
    }

    /// Name, first and last time of each line.
    pub fn spans(&self) -> Vec<(String, f64, f64)> {
        let one = |line: &DetectedLine| {
            let (from, to) = self.times_s(line);
            (line.name.clone(), from, to)
        };
        self.lines.iter().map(one).collect()
    }

    /// Replaces the detected lines by `lines`: name, first and last time, in seconds past midnight UTC. The first
    /// letters of the name determine the kind.
    pub fn divide(&mut self, lines: &[(String, f64, f64)]) {
        let tt = &self.motion.tt_s;
        let one = |(name, from, to): &(String, f64, f64)| {
            let rows = tt.partition_point(|t| t < from)..tt.partition_point(|t| t <= to);
            let kind =
                LinePattern::ALL.into_iter().find(|kind| name.starts_with(kind.word())).unwrap_or(LinePattern::Line);
            DetectedLine { name: name.clone(), kind, rows, heading_deg: None, manoeuvres: [false; 3] }
        };
        self.lines = lines.iter().map(one).filter(|line| !line.rows.is_empty()).collect();
    }

    /// Fault of a flight without lines; `None` if the flight has lines.
    pub fn missing(&self, flight: &str) -> Option<Fault> {
        if !self.lines.is_empty() {
            return None;
        }
        let known = |x: &[f64]| x.iter().any(|x| x.is_finite());
        let fault = if !known(&self.motion.course_deg) {
            let what = format!("flight {flight} has neither positions nor headings, so lines cannot be found");
            let help = "find the lines with all tables of the log, `magline ingest LOG --lines auto --to DIR`, and use \
                        the table that it writes: `lines = \"DIR/_lines/LOG.csv\"`";
            Fault::data(what).help(help)
        } else {
            let what = format!("no lines were found in flight {flight}: it has no long straight stretch");
            Fault::data(what).help("give a table of `flight`, `line`, `t_start` and `t_end`, or remove `lines`")
        };
        Some(fault)
    }
}

/// The lines of flights as a table of lines, in CSV. The columns after the first four are for information only.
pub fn csv(flights: &[(String, LineDetection)]) -> String {
    let mut text = "flight,line,t_start,t_end,kind,heading_deg,length_m,alt_m,manoeuvres\n".to_owned();
    for (flight, found) in flights {
        for line in &found.lines {
            let (from, to) = found.times_s(line);
            let shown = |x: Option<f64>| x.filter(|x| x.is_finite()).map(|x| format!("{x:.0}")).unwrap_or_default();
            let words =
                ["roll", "pitch", "yaw"].into_iter().zip(line.manoeuvres).filter(|(_, has_manoeuvre)| *has_manoeuvre);
            let manoeuvres: Vec<&str> = words.map(|(word, _)| word).collect();
            // Writing into a string cannot fail.
            let _ = writeln!(
                text,
                "{},{},{from:.1},{to:.1},{},{},{},{},{}",
                quoted(flight),
                line.name,
                line.kind.word(),
                shown(line.heading_deg.map(|h| h.round() % 360.0)),
                shown(found.length_m(line)),
                shown(found.height_m(line)),
                manoeuvres.join(" "),
            );
        }
    }
    text
}

/// A cell of CSV.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

impl LineDetection {
    /// Length of the track along a line, in metres; `None` without positions.
    pub fn length_m(&self, line: &DetectedLine) -> Option<f64> {
        let north = self.motion.north_m.get(line.rows.clone())?;
        let east = self.motion.east_m.get(line.rows.clone())?;
        let steps = north.windows(2).zip(east.windows(2)).map(|(n, e)| (n[1] - n[0]).hypot(e[1] - e[0]));
        let length: f64 = steps.filter(|step| step.is_finite()).sum();
        (length > 0.0).then_some(length)
    }

    /// The mean height of a line, in metres.
    pub fn height_m(&self, line: &DetectedLine) -> Option<f64> {
        let all = self.motion.alt_m.get(line.rows.clone())?;
        let known: Vec<f64> = all.iter().copied().filter(|x| x.is_finite()).collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
    }
}
