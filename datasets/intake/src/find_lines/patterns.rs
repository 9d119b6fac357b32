//! Calibration boxes, cloverleafs, figures of eight, circles, survey lines and tie lines among the legs of a flight.

use std::ops::Range;

use numerics::angle::wrap_deg;

use super::{
    legs::{FlightSegments, StraightLeg},
    motion::{FlightMotion, RATE_HZ},
};

/// Flight pattern of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinePattern {
    /// A straight line.
    Line,
    /// A line across two or more of the survey's lines.
    Tie,
    /// Legs at right angles to each other, with manoeuvres.
    Box,
    /// Crossings of one place on several courses, connected by loops to one side.
    Cloverleaf,
    /// Crossings of one place on several courses, connected by loops to alternate sides.
    FigureEight,
    /// A full turn or more.
    Circle,
}

impl LinePattern {
    /// All patterns.
    pub const ALL: [LinePattern; 6] = [
        LinePattern::Line,
        LinePattern::Tie,
        LinePattern::Box,
        LinePattern::Cloverleaf,
        LinePattern::FigureEight,
        LinePattern::Circle,
    ];

    /// The pattern as text; the names of its lines begin with this text.
    pub const fn word(self) -> &'static str {
        match self {
            LinePattern::Line => "line",
            LinePattern::Tie => "tie",
            LinePattern::Box => "box",
            LinePattern::Cloverleaf => "cloverleaf",
            LinePattern::FigureEight => "figure_eight",
            LinePattern::Circle => "circle",
        }
    }
}

/// A detected line.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedLine {
    /// Name from the kind and the number of the line, such as `box1`. All numbers of a kind have the same number of
    /// digits.
    pub name: String,
    /// Kind of the line.
    pub kind: LinePattern,
    /// Rows of the line in the motion at evenly spaced times.
    pub rows: Range<usize>,
    /// The course of a straight line, 0 to 360 degrees.
    pub heading_deg: Option<f64>,
    /// Whether roll, pitch and yaw show a manoeuvre on any leg of the line.
    pub manoeuvres: [bool; 3],
}

/// Range of angles between legs that count as a right angle, in degrees.
const RIGHT_ANGLE_DEG: (f64, f64) = (60.0, 120.0);
/// Minimum number of legs of a box, and minimum share of its legs with manoeuvres of the same angle.
const BOX_LEGS: usize = 4;
const BOX_PART: f64 = 0.75;
/// Minimum and maximum turn, in degrees, of a loop that leads back over its start.
const LOOP_DEG: (f64, f64) = (180.0, 340.0);
/// Maximum distance of a crossing beyond the end of a leg, relative to the length of the leg.
const BEYOND: f64 = 0.1;
/// Maximum distance between crossings at one place: a share of the distance from the place to the loop, and a length in
/// metres.
const SAME_PART: f64 = 0.35;
const SAME_M: f64 = 10.0;
/// Assumed distance flown to the first loop and from the last loop, relative to the distance from the place to the
/// loop.
const LEAD: f64 = 1.5;
/// Minimum number of loops of a figure of eight, and of a cloverleaf. Two loops to one side may also lead from a survey
/// line to the next survey line, if that line is near.
const EIGHT: usize = 2;
const CLOVER: usize = 3;
/// Minimum turn of a circle, in degrees; a turn begins and ends slowly.
const CIRCLE_DEG: f64 = 340.0;
/// Minimum duration of a line: a share of the longest leg, within limits in seconds. If the second share of the longest
/// leg is below the lower limit, it replaces this limit.
const SHORTEST: f64 = 0.1;
const SHORTEST_S: (f64, f64) = (10.0, 30.0);
const SHORTEST_OF_SHORT: f64 = 0.35;
/// Maximum length of a leg that only connects two parallel legs, relative to the length of each parallel leg.
const CONNECTS: f64 = 0.6;
/// Maximum deviation of survey lines from the survey's axis, and of tie lines from its perpendicular, in degrees.
const ALONG_DEG: f64 = 25.0;
/// Minimum concentration of the lines about one axis, 0 to 1.
const ONE_AXIS: f64 = 0.2;

type NorthEast = (f64, f64);

/// Motion and segments of a flight.
struct SegmentedFlight<'a> {
    motion: &'a FlightMotion,
    parts: &'a FlightSegments,
}

/// Loop between two legs that cross.
struct TurnLoop {
    /// The leg before the loop.
    leg: usize,
    /// The leg after the loop; `None` if the flight ends with the loop.
    next: Option<usize>,
    right: bool,
    /// Crossing of the legs: north and east, in metres.
    place: NorthEast,
    /// Distance from the crossing to the loop, in metres.
    lead_m: f64,
    /// Rows at which the crossing is passed before and after the loop.
    passes: (usize, usize),
}

/// The lines of a flight, in the order of their times.
pub fn lines(motion: &FlightMotion, parts: &FlightSegments) -> Vec<DetectedLine> {
    let flight = SegmentedFlight { motion, parts };
    let mut found: Vec<DetectedLine> = vec![];
    let mut taken = vec![false; parts.legs.len()];
    let least = flight.shortest();
    let mut rest: Vec<Range<usize>> = vec![];
    for group in flight.crossings() {
        let (line, legs) = flight.over_one_place(&group);
        taken.iter_mut().take(legs.end).skip(legs.start).for_each(|t| *t = true);
        // Long remaining parts of the first and the last leg are separate lines.
        let ends = legs.clone().next().into_iter().chain(legs.last());
        for leg in ends.filter_map(|i| parts.legs.get(i)) {
            rest.push(leg.rows.start..leg.rows.end.min(line.rows.start));
            rest.push(leg.rows.start.max(line.rows.end)..leg.rows.end);
        }
        found.push(line);
    }
    for legs in flight.boxes(&taken) {
        found.push(flight.one(LinePattern::Box, legs.clone()));
        taken.iter_mut().take(legs.end).skip(legs.start).for_each(|t| *t = true);
    }
    let within = |rows: &Range<usize>, lines: &[DetectedLine]| {
        lines.iter().any(|l| l.rows.start < rows.end && rows.start < l.rows.end)
    };
    let circles = parts.turns.iter().filter(|t| t.change_deg.abs() >= CIRCLE_DEG && !within(&t.rows, &found));
    let circle = |rows: &Range<usize>| flight.line(LinePattern::Circle, rows.clone(), [false; 3]);
    let circles: Vec<DetectedLine> = circles.map(|t| circle(&t.rows)).collect();
    found.extend(circles);
    let free = (0..parts.legs.len()).filter(|i| taken.get(*i) == Some(&false) && !flight.connects(*i));
    let legs = free.filter_map(|i| parts.legs.get(i));
    let mut straight: Vec<DetectedLine> =
        legs.map(|leg| flight.line(LinePattern::Line, leg.rows.clone(), leg.manoeuvres)).collect();
    straight.extend(rest.into_iter().map(|rows| flight.line(LinePattern::Line, rows, [false; 3])));
    straight.retain(|line| line.rows.len() >= least);
    flight.tie(&mut straight);
    found.extend(straight);
    found.sort_by_key(|line| line.rows.start);
    name(&mut found);
    found
}

/// Numbers the lines of each kind.
fn name(lines: &mut [DetectedLine]) {
    for kind in LinePattern::ALL {
        let all = lines.iter().filter(|l| l.kind == kind).count();
        let digits = all.to_string().len();
        for (i, line) in lines.iter_mut().filter(|l| l.kind == kind).enumerate() {
            line.name = format!("{}{:0digits$}", kind.word(), i + 1);
        }
    }
}

impl SegmentedFlight<'_> {
    fn at(&self, row: usize) -> NorthEast {
        let of = |x: &[f64]| x.get(row).copied().unwrap_or(f64::NAN);
        (of(&self.motion.north_m), of(&self.motion.east_m))
    }

    fn ends(&self, rows: &Range<usize>) -> (NorthEast, NorthEast) {
        (self.at(rows.start), self.at(rows.end.saturating_sub(1)))
    }

    /// Minimum number of rows of a line.
    fn shortest(&self) -> usize {
        let longest = self.parts.legs.iter().map(|l| l.rows.len()).max().unwrap_or(0) as f64;
        let least = (SHORTEST_S.0 * RATE_HZ).min(SHORTEST_OF_SHORT * longest);
        (SHORTEST * longest).clamp(least, SHORTEST_S.1 * RATE_HZ) as usize
    }

    fn line(&self, kind: LinePattern, rows: Range<usize>, manoeuvres: [bool; 3]) -> DetectedLine {
        let (from, to) = self.ends(&rows);
        let straight = matches!(kind, LinePattern::Line | LinePattern::Tie);
        let heading = (to.1 - from.1).atan2(to.0 - from.0).to_degrees().rem_euclid(360.0);
        let heading = if heading.is_finite() { heading } else { self.motion.heading_deg(rows.start) };
        DetectedLine { name: String::new(), kind, rows, heading_deg: straight.then_some(heading), manoeuvres }
    }

    /// One line of several legs.
    fn one(&self, kind: LinePattern, legs: Range<usize>) -> DetectedLine {
        let all = self.parts.legs.get(legs).unwrap_or_default();
        let rows = all.first().map_or(0, |l| l.rows.start)..all.last().map_or(0, |l| l.rows.end);
        let manoeuvres = std::array::from_fn(|angle| all.iter().any(|leg| leg.manoeuvres[angle]));
        self.line(kind, rows, manoeuvres)
    }

    /// Whether a leg only connects a line with the adjacent line.
    fn connects(&self, number: usize) -> bool {
        let legs = &self.parts.legs;
        let near = number.checked_sub(1).and_then(|before| legs.get(before)).zip(legs.get(number + 1));
        let (Some((before, after)), Some(leg)) = (near, legs.get(number)) else { return false };
        let off = |other: &StraightLeg| {
            let off = (leg.course_deg - other.course_deg).rem_euclid(180.0);
            off.min(180.0 - off)
        };
        let across = off(before) >= 90.0 - ALONG_DEG && off(after) >= 90.0 - ALONG_DEG;
        let shorter = (leg.rows.len() as f64) < CONNECTS * before.rows.len().min(after.rows.len()) as f64;
        before.run == leg.run && after.run == leg.run && across && shorter
    }

    /// Groups of loops over one place.
    fn crossings(&self) -> Vec<Vec<TurnLoop>> {
        let mut groups: Vec<Vec<TurnLoop>> = vec![];
        for leg in 0..self.parts.legs.len() {
            let Some(found) = self.loop_after(leg) else { continue };
            let is_continued = |last: &TurnLoop| {
                let off = (last.place.0 - found.place.0).hypot(last.place.1 - found.place.1);
                last.next == Some(leg) && off <= SAME_PART * last.lead_m.min(found.lead_m) + SAME_M
            };
            match groups.last_mut() {
                Some(group) if group.last().is_some_and(is_continued) => group.push(found),
                _ => groups.push(vec![found]),
            }
        }
        groups.retain(|group| group.len() >= if to_each_side(group) { EIGHT } else { CLOVER });
        groups
    }

    /// Loop that begins at the end of a leg and leads back across that leg.
    fn loop_after(&self, number: usize) -> Option<TurnLoop> {
        let legs = &self.parts.legs;
        let leg = legs.get(number)?;
        let run = self.motion.runs.get(leg.run)?;
        let after = legs.get(number + 1).filter(|next| next.run == leg.run);
        let (turned_deg, rows) = match after {
            Some(next) => (self.parts.turned_deg(self.motion, leg, next)?, next.rows.clone()),
            // The flight ends with the loop, so the last second of the loop gives the direction.
            None => {
                let course = |row: usize| self.motion.course_deg.get(row).copied();
                let last = run.end.checked_sub(1)?;
                (course(last)? - course(leg.rows.end.checked_sub(1)?)?, run.end.checked_sub(RATE_HZ as usize)?..run.end)
            }
        };
        if !(LOOP_DEG.0..LOOP_DEG.1).contains(&turned_deg.abs()) {
            return None;
        }
        let (place, along, along_next) = crossing(self.ends(&leg.rows), self.ends(&rows))?;
        let (from, to) = self.ends(&leg.rows);
        let length_m = (to.0 - from.0).hypot(to.1 - from.1);
        let lead_m = (1.0 - along) * length_m;
        let on_leg = -BEYOND..1.0 + BEYOND;
        let row_at = |rows: &Range<usize>, part: f64| rows.start + (part.clamp(0.0, 1.0) * rows.len() as f64) as usize;
        let reached = match after {
            Some(_) => on_leg.contains(&along_next),
            None => {
                let (a, b) = self.ends(&rows);
                let ahead_m = along_next * (b.0 - a.0).hypot(b.1 - a.1);
                (0.0..2.0 * lead_m.max(1.0)).contains(&ahead_m)
            }
        };
        (on_leg.contains(&along) && reached).then(|| TurnLoop {
            leg: number,
            next: after.map(|_| number + 1),
            right: turned_deg > 0.0,
            place,
            lead_m,
            passes: (row_at(&leg.rows, along), row_at(&rows, along_next)),
        })
    }

    /// The line that consists of loops over one place, and its legs.
    fn over_one_place(&self, group: &[TurnLoop]) -> (DetectedLine, Range<usize>) {
        let (Some(first), Some(last)) = (group.first(), group.last()) else {
            return (self.line(LinePattern::Cloverleaf, 0..0, [false; 3]), 0..0);
        };
        let legs = first.leg..last.next.unwrap_or(last.leg) + 1;
        let kind = if to_each_side(group) { LinePattern::FigureEight } else { LinePattern::Cloverleaf };
        let mut line = self.one(kind, legs.clone());
        let lead = |rows: usize| (LEAD * rows as f64) as usize;
        if let Some(leg) = self.parts.legs.get(first.leg) {
            let to_loop = leg.rows.end.saturating_sub(first.passes.0);
            line.rows.start = line.rows.start.max(first.passes.0.saturating_sub(lead(to_loop)));
        }
        match last.next.and_then(|next| self.parts.legs.get(next)) {
            Some(leg) => {
                let from_loop = last.passes.1.saturating_sub(leg.rows.start);
                line.rows.end = line.rows.end.min(last.passes.1 + lead(from_loop));
            }
            None => {
                let run = self.parts.legs.get(last.leg).and_then(|leg| self.motion.runs.get(leg.run));
                line.rows.end = run.map_or(line.rows.end, |run| run.end);
            }
        }
        (line, legs)
    }

    /// Legs that follow each other at right angles to one side, with manoeuvres.
    fn boxes(&self, taken: &[bool]) -> Vec<Range<usize>> {
        let legs = &self.parts.legs;
        let side = |i: usize| -> Option<bool> {
            let (from, to) = (legs.get(i)?, legs.get(i + 1)?);
            if taken.get(i) != Some(&false) || taken.get(i + 1) != Some(&false) {
                return None;
            }
            let turned = wrap_deg(self.parts.turned_deg(self.motion, from, to)?);
            (RIGHT_ANGLE_DEG.0..RIGHT_ANGLE_DEG.1).contains(&turned.abs()).then_some(turned > 0.0)
        };
        let mut groups: Vec<(Option<bool>, Range<usize>)> = vec![];
        for i in 0..legs.len() {
            let to = side(i);
            match groups.last_mut() {
                Some((known, group)) if to.is_some() && *known == to => group.end = i + 2,
                _ => groups.push((to, i..i + if to.is_some() { 2 } else { 1 })),
            }
        }
        let busy = |i: usize, angle: usize| legs.get(i).is_some_and(|leg| leg.manoeuvres[angle]);
        let trimmed = |(_, group): (Option<bool>, Range<usize>)| {
            let any = |i: &usize| (0..3).any(|angle| busy(*i, angle));
            let (first, last) = (group.clone().find(any)?, group.rev().find(any)?);
            let group = first..last + 1;
            let with = |angle: usize| group.clone().filter(|i| busy(*i, angle)).count() as f64;
            let enough = (0..3).any(|angle| with(angle) >= BOX_PART * group.len() as f64);
            (group.len() >= BOX_LEGS && enough).then_some(group)
        };
        groups.into_iter().filter_map(trimmed).collect()
    }

    /// Distinguishes tie lines from the lines that they cross.
    fn tie(&self, lines: &mut [DetectedLine]) {
        let sides: Vec<(NorthEast, NorthEast)> = lines.iter().map(|l| self.ends(&l.rows)).collect();
        let vector = |(a, b): &(NorthEast, NorthEast)| (b.0 - a.0, b.1 - a.1);
        // The angle is doubled, so that opposite directions count as one axis.
        let (mut cos, mut sin, mut all_m) = (0.0, 0.0, 0.0);
        for side in &sides {
            let (n, e) = vector(side);
            let length_m = n.hypot(e);
            if length_m > 0.0 {
                cos += (n * n - e * e) / length_m;
                sin += 2.0 * n * e / length_m;
                all_m += length_m;
            }
        }
        if f64::hypot(cos, sin) <= ONE_AXIS * all_m {
            return;
        }
        let axis_deg = 0.5 * sin.atan2(cos).to_degrees();
        let off_deg = |side: &(NorthEast, NorthEast)| {
            let (n, e) = vector(side);
            let off = (e.atan2(n).to_degrees() - axis_deg).rem_euclid(180.0);
            off.min(180.0 - off)
        };
        let survey: Vec<&(NorthEast, NorthEast)> = sides.iter().filter(|s| off_deg(s) <= ALONG_DEG).collect();
        // A tie line may begin and end on survey lines. A leg that crosses the survey lines beyond their ends connects
        // two of them.
        let on = |(_, tie, line): (NorthEast, f64, f64)| {
            (-BEYOND..1.0 + BEYOND).contains(&tie) && (0.0..=1.0).contains(&line)
        };
        for (line, side) in lines.iter_mut().zip(&sides) {
            let crosses = |other: &&&(NorthEast, NorthEast)| crossing(*side, ***other).is_some_and(on);
            if off_deg(side) >= 90.0 - ALONG_DEG && survey.iter().filter(crosses).count() >= 2 {
                line.kind = LinePattern::Tie;
            }
        }
    }
}

/// Whether each loop is to the other side than the loop before it.
fn to_each_side(group: &[TurnLoop]) -> bool {
    group.windows(2).all(|w| w[0].right != w[1].right)
}

/// Crossing of two straight lines, and its distance along each of them as a fraction of that line's length; `None` if
/// the lines are nearly parallel.
fn crossing(a: (NorthEast, NorthEast), b: (NorthEast, NorthEast)) -> Option<(NorthEast, f64, f64)> {
    /// Minimum sine of the angle between the lines.
    const LEAST: f64 = 0.5;
    let (u, v) = ((a.1.0 - a.0.0, a.1.1 - a.0.1), (b.1.0 - b.0.0, b.1.1 - b.0.1));
    let across = u.0 * v.1 - u.1 * v.0;
    if !(across.abs() >= LEAST * u.0.hypot(u.1) * v.0.hypot(v.1) && across != 0.0) {
        return None;
    }
    let from = (b.0.0 - a.0.0, b.0.1 - a.0.1);
    let along = (from.0 * v.1 - from.1 * v.0) / across;
    let along_b = (from.0 * u.1 - from.1 * u.0) / across;
    Some(((a.0.0 + along * u.0, a.0.1 + along * u.1), along, along_b))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn law_two_diagonals_cross_in_the_middle_and_parallels_do_not() {
        let (place, a, b) = crossing(((0.0, 0.0), (10.0, 10.0)), ((0.0, 10.0), (5.0, 5.0))).unwrap();
        assert!((place.0 - 5.0).hypot(place.1 - 5.0) < 1e-12 && (a - 0.5).abs() < 1e-12 && (b - 1.0).abs() < 1e-12);
        assert_eq!(crossing(((0.0, 0.0), (10.0, 0.0)), ((1.0, 1.0), (11.0, 2.0))), None);
        assert_eq!(crossing(((0.0, 0.0), (0.0, 0.0)), ((1.0, 1.0), (11.0, 2.0))), None);
    }
}
