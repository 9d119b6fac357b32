//! What the spec says of the flights: their lines, where these go, and how.

use super::{
    super::spec::{
        section::{Need, Section},
        unique,
    },
    air::Air,
    kinds::{Grid, Orbit, Path2d},
    plan::{Heights, Plan, Request},
    route::Impossible,
};

/// A flight: a table of `flights`.
#[derive(Clone, Debug)]
pub struct Flight {
    /// `name`: its identifier.
    pub name: String,
    /// Its lines, in time: the tables `flights.lines`, of which some are several lines.
    pub lines: Vec<Line>,
}

/// A line of a flight.
#[derive(Clone, Debug)]
pub struct Line {
    /// `name`: its identifier.
    pub name: String,
    /// `start_tt_s`: when it begins, in seconds past midnight UTC; a minute after the end of the line before it
    /// where left out, the flight's `start_tt_s` for the first.
    pub start_tt_s: f64,
    /// `alt_m`: height above the WGS-84 ellipsoid, in metres.
    pub alt_m: f64,
    /// `speed_mps`: airspeed, in m/s, which without wind is the speed over ground; 1 to 1000, 60 where left out.
    pub speed_mps: f64,
    /// `radius_m`: of its turns and circles, in metres; as tight as `bank_deg` of `dynamics` allows where left out.
    pub radius_m: Option<f64>,
    /// Its heights, where it has more than one.
    pub heights: Heights,
    /// `kind` and its keys: where it goes.
    pub path: Path2d,
    /// How it is flown.
    pub(super) plan: Plan,
}

/// Reads the flights.
pub(in super::super) fn flights(root: &Section, air: &Air) -> Vec<Flight> {
    let flights: Vec<_> = root.sections("flights").iter().map(|s| flight(s, air)).collect();
    let of_lines = |f: &Flight| f.lines.iter().map(|l| format!("{}/{}", f.name, l.name)).collect::<Vec<_>>();
    unique(root, "flight", flights.iter().map(|c| c.name.clone()));
    unique(root, "line", flights.iter().flat_map(of_lines));
    if flights.iter().all(|f| f.lines.is_empty()) {
        root.fault("the spec has no flight with a line".to_owned());
    }
    flights
}

/// Seconds from the end of a line to the start of the next, where the spec does not say.
const PAUSE_S: f64 = 60.0;

fn flight(s: &Section, air: &Air) -> Flight {
    let name = s.text("name");
    let mut next_s = s.number("start_tt_s", 0.0, Need::NotNegative);
    let mut lines: Vec<Line> = vec![];
    for one in s.sections("lines") {
        let found = self::lines(&one, next_s, air);
        if found.first().is_some_and(|line| line.start_tt_s < next_s - PAUSE_S) {
            one.fault_at("start_tt_s", "the line starts before the one before it ends".to_owned());
        }
        if let Some(last) = found.last() {
            next_s = last.start_tt_s + last.duration_s() + PAUSE_S;
        }
        lines.extend(found);
    }
    s.finish();
    Flight { name, lines }
}

const KINDS: [&str; 9] = ["survey", "box", "free", "grid", "circle", "looping", "loiter", "figure_eight", "cloverleaf"];

/// The lines of one table.
fn lines(s: &Section, next_s: f64, air: &Air) -> Vec<Line> {
    let kind = s.word("kind", &KINDS);
    let common = Line {
        name: s.text("name"),
        start_tt_s: s.number("start_tt_s", next_s, Need::NotNegative),
        alt_m: s.needed("alt_m", Need::Between(-1000.0, 30_000.0)),
        speed_mps: s.number("speed_mps", 60.0, Need::Between(1.0, 1000.0)),
        // The radius of survey lines and free flights is the aircraft's own, too.
        radius_m: s.optional("radius_m", Need::Between(1.0, 1e6)),
        heights: Heights::default(),
        path: Path2d::Free { waypoints: vec![] },
        plan: Plan::default(),
    };
    let faults = s.faults();
    let one = |path: Path2d| vec![Line { path, ..common.clone() }];
    let heading_deg = || s.number("heading_deg", 0.0, Need::Between(-360.0, 360.0));
    let rounds = || s.whole("rounds", 1, 1, 1000) as u32;
    let found = match kind {
        0 | 2 => vec![waypoints(s, kind == 0, &common)],
        1 => boxes(s, &common),
        3 => return grid(s, &common, air),
        4 => one(Path2d::Circle { orbit: orbit(s), turns: s.number("turns", 1.0, Need::Between(0.01, 1000.0)) }),
        5 => one(Path2d::Looping {
            orbit: orbit(s),
            turns: s.number("turns", 1.0, Need::Between(0.1, 100.0)),
            rounds: s.whole("rounds", 1, 1, 100) as u32,
            top_m: s.needed("top_m", Need::Between(-1000.0, 30_000.0)),
        }),
        6 => one(Path2d::Loiter {
            start: place(s, "start"),
            heading_deg: heading_deg(),
            leg_m: s.number("leg_m", 2000.0, Need::Between(0.0, 1e6)),
            rounds: rounds(),
            right: right(s, "direction"),
        }),
        7 => one(Path2d::FigureEight { center: place(s, "center"), heading_deg: heading_deg(), rounds: rounds() }),
        _ => one(Path2d::Cloverleaf {
            center: place(s, "center"),
            heading_deg: heading_deg(),
            crossings: s.whole("crossings", 4, 1, 1000) as u32,
            right: right(s, "direction"),
        }),
    };
    s.finish();
    // A line whose numbers are wrong is not flown, nor complained of twice.
    if s.faults() > faults || common.alt_m.is_nan() { found } else { planned(s, found, air) }
}

/// Plans lines that follow each other.
fn planned(s: &Section, mut lines: Vec<Line>, air: &Air) -> Vec<Line> {
    let mut next_s = lines.first().map_or(0.0, |line| line.start_tt_s);
    for line in &mut lines {
        line.start_tt_s = next_s;
        match line.planned(air) {
            Ok(plan) => line.plan = plan,
            Err(e) => s.fault_at(e.key, e.what),
        }
        next_s += line.duration_s() + PAUSE_S;
    }
    lines
}

impl Line {
    fn planned(&self, air: &Air) -> Result<Plan, Impossible> {
        Plan::new(&Request {
            path: &self.path,
            alt_m: self.alt_m,
            heights: &self.heights,
            airspeed_mps: self.speed_mps,
            radius_m: self.radius_m,
            air,
        })
    }
}

fn waypoints(s: &Section, again: bool, common: &Line) -> Line {
    let waypoints = s.places("waypoints");
    let alts_m = s.list("alts_m", Need::Between(-1000.0, 30_000.0));
    if alts_m.as_ref().is_some_and(|alts| !waypoints.is_empty() && alts.len() != waypoints.len()) {
        s.fault_at("alts_m", format!("`alts_m` must have one height for each of the {} waypoints", waypoints.len()));
    }
    let drape = s.flag("drape", false);
    if drape && alts_m.is_none() {
        s.fault_at("drape", "`drape` needs `alts_m`, the heights of the surface at the waypoints".to_owned());
    }
    let path = if again {
        let duration_s = s.needed("duration_s", Need::Between(1.0, 1e5));
        let weave_deg = s.number("weave_deg", 0.0, Need::Between(0.0, 45.0));
        let weave_deg_s = (weave_deg, s.number("weave_period_s", 120.0, Need::Positive));
        Path2d::Survey { waypoints, duration_s, weave_deg_s }
    } else {
        Path2d::Free { waypoints }
    };
    Line { path, heights: Heights { alts_m, drape }, ..common.clone() }
}

/// Table 5.7 of thesis 000: amplitudes of roll, pitch and yaw, in degrees, and manoeuvres per leg, of its
/// sets 1 to 18. Each angle has 2 or 6 swings; an angle of 0 is not flown.
fn set(number: usize) -> ([f64; 3], u32) {
    let (group, scale) = ((number - 1) / 3, [1.0, 2.0, 4.0][(number - 1) % 3]);
    let (roll, yaw) = (if group >= 2 { 5.0 } else { 0.0 }, if group >= 4 { 2.5 } else { 0.0 });
    ([roll * scale, 2.5 * scale, yaw * scale], if group % 2 == 0 { 2 } else { 6 })
}

/// `kind = "box"`. `sets = [first, last]` are those of thesis 000, table 5.7, one line each.
fn boxes(s: &Section, common: &Line) -> Vec<Line> {
    let start = place(s, "start");
    let heading_deg = s.number("heading_deg", 0.0, Need::Between(-360.0, 360.0));
    let period_s = s.number("period_s", 6.0, Need::Between(1.0, 60.0));
    let legs = s.whole("legs", 4, 1, 64) as u32;
    let path = |amplitude_deg, cycles| Path2d::Box { start, heading_deg, amplitude_deg, period_s, cycles, legs };
    let [first, last] = s.numbers("sets", [0.0; 2], Need::Between(1.0, 18.0));
    if first == 0.0 {
        // Figure 3-7 of the thesis: 4.5 degrees of pitch, 9 of roll, 5 of yaw, 6 s.
        let amplitude_deg = s.numbers("amplitude_deg", [9.0, 4.5, 5.0], Need::Between(0.0, 40.0));
        let cycles = s.whole("cycles", 3, 1, 100) as u32;
        return vec![Line { path: path(amplitude_deg, cycles), ..common.clone() }];
    }
    if first.fract() != 0.0 || last.fract() != 0.0 || first > last {
        s.fault_at("sets", "`sets` must be two whole numbers in order, such as [1, 18]".to_owned());
    }
    let several = first < last;
    let one = |number: usize| {
        let (amplitude_deg, cycles) = set(number);
        let name = if several { format!("{}.{number:02}", common.name) } else { common.name.clone() };
        Line { name, path: path(amplitude_deg, cycles), ..common.clone() }
    };
    (first as usize..=last as usize).map(one).collect()
}

/// `kind = "grid"`: with `split = true`, which is the default, each survey line is a line `NAME.01`, `NAME.02`...
/// and each tie line `NAME.T01`..., in the order and at the times that they are flown, the turns left out.
fn grid(s: &Section, common: &Line, air: &Air) -> Vec<Line> {
    let faults = s.faults();
    let grid = Grid {
        origin: place(s, "origin"),
        heading_deg: s.number("heading_deg", 0.0, Need::Between(-360.0, 360.0)),
        line_m: s.needed("line_m", Need::Between(1.0, 1e6)),
        spacing_m: s.needed("spacing_m", Need::Between(0.1, 1e5)),
        count: s.whole("count", 1, 1, 10_000) as u32,
        tie_spacing_m: s.optional("tie_spacing_m", Need::Between(1.0, 1e6)),
        right: right(s, "side"),
    };
    let split = s.flag("split", true);
    s.finish();
    let whole = Line { path: Path2d::Grid(grid), ..common.clone() };
    if s.faults() > faults || common.alt_m.is_nan() {
        return vec![whole];
    }
    let whole = planned(s, vec![whole], air);
    let Some(flown) = whole.first().filter(|_| split) else { return whole };
    let (mut numbers, mut lines) = ([0, 0], vec![]);
    for (stretch, start_s) in grid.stretches().iter().zip(&flown.plan.marks_s) {
        let number = &mut numbers[usize::from(stretch.tie)];
        *number += 1;
        let name = format!("{}.{}{number:02}", common.name, if stretch.tie { "T" } else { "" });
        let (start, heading_deg) = (stretch.start.degrees(), stretch.start.course_rad.to_degrees());
        let path = Path2d::Traverse { start, heading_deg, length_m: stretch.length_m };
        let line = Line { name, path, start_tt_s: common.start_tt_s + start_s, ..common.clone() };
        lines.extend(planned(s, vec![line], air));
    }
    lines
}

fn orbit(s: &Section) -> Orbit {
    Orbit {
        center: place(s, "center"),
        from_deg: s.number("from_deg", 0.0, Need::Between(-360.0, 360.0)),
        right: right(s, "direction"),
    }
}

fn right(s: &Section, key: &'static str) -> bool {
    s.word(key, &["right", "left"]) == 0
}

/// A place that must be there, in degrees.
fn place(s: &Section, key: &'static str) -> (f64, f64) {
    let [lat, lon] = s.numbers(key, [f64::NAN; 2], Need::Between(-360.0, 360.0));
    if lat.is_nan() || lat.abs() >= 89.0 {
        s.fault_at(key, format!("`lines` of this kind needs `{key}`, its [latitude, longitude] in degrees"));
    }
    (lat, lon)
}
