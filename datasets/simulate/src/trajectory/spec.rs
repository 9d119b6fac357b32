//! Keys of the flights and their lines in a synth spec.

use schemas::{ChoiceRegistry, ChoiceSelection, Rule, choice, params};

use crate::reading::{
    SynthSection, unique,
    variant::{SynthVariant, SynthVariantValue, variant},
};

use super::{
    air::FlightConditions,
    kinds::{HorizontalPath, Orbit, SurveyLineGrid},
    plan::{LineHeights, TrajectoryPlan, TrajectoryRequest},
    route::RouteError,
};

/// A flight: a table of `flights`.
#[derive(Clone, Debug)]
pub struct SynthFlight {
    /// Identifier.
    pub name: String,
    /// Lines in the order of time, from the tables `flights.lines`. One table can give several lines.
    pub lines: Vec<SynthLine>,
}

/// A line of a flight.
#[derive(Clone, Debug)]
pub struct SynthLine {
    /// Identifier.
    pub name: String,
    /// Start, in seconds past midnight UTC. If unset, 60 s after the end of the previous line; for the first line, the
    /// flight's `start_tt_s`.
    pub start_tt_s: f64,
    /// Height above the WGS-84 ellipsoid, in metres.
    pub alt_m: f64,
    /// Airspeed, in m/s; without wind, it equals the speed over ground. 1 to 1000, default 60.
    pub speed_mps: f64,
    /// Radius of turns and circles, in metres. If unset, the smallest that `bank_deg` of `dynamics` allows.
    pub radius_m: Option<f64>,
    /// Heights of the line, if there are several.
    pub heights: LineHeights,
    /// `kind` and its keys: the path of the line.
    pub path: HorizontalPath,
    /// The plan of the flown line.
    pub(super) plan: TrajectoryPlan,
}

/// Reads the flights.
pub(in super::super) fn flights(root: &SynthSection, air: &FlightConditions) -> Vec<SynthFlight> {
    let before = root.faults();
    let flights: Vec<_> = root.sections("flights").iter().flat_map(|s| copies_of(s, air)).collect();
    let of_lines = |f: &SynthFlight| f.lines.iter().map(|l| format!("{}/{}", f.name, l.name)).collect::<Vec<_>>();
    unique(root, "flight", flights.iter().map(|c| c.name.clone()));
    unique(root, "line", flights.iter().flat_map(of_lines));
    if flights.iter().all(|f| f.lines.is_empty()) && root.faults() == before {
        root.fault("the spec has no flight with a line".to_owned());
    }
    flights
}

/// Default time from the end of a line to the start of the next line, in seconds.
const PAUSE_S: f64 = 60.0;

/// The flights of one table `flights`: one flight, or the number of copies in `copies`.
fn copies_of(s: &SynthSection, air: &FlightConditions) -> Vec<SynthFlight> {
    let Some(keys) = s.some_keys::<FlightKeys>() else { return vec![] };
    let name = keys.name.clone();
    let (copies, flight) = (keys.copies, flight(s, keys, air));
    match copies {
        None => vec![flight],
        Some(copies) => (1..=copies).map(|k| SynthFlight { name: format!("{name}-{k}"), ..flight.clone() }).collect(),
    }
}

fn flight(s: &SynthSection, keys: FlightKeys, air: &FlightConditions) -> SynthFlight {
    let mut next_s = keys.start_tt_s;
    let mut lines: Vec<SynthLine> = vec![];
    for one in s.sections("lines") {
        let found = self::lines(&one, next_s, air);
        if found.first().is_some_and(|line| line.start_tt_s < next_s - PAUSE_S) {
            one.fault_at("start_tt_s", "the line starts before the previous line ends".to_owned());
        }
        if let Some(last) = found.last() {
            next_s = last.start_tt_s + last.duration_s() + PAUSE_S;
        }
        lines.extend(found);
    }
    s.finish();
    SynthFlight { name: keys.name, lines }
}

/// The path of a line: its kind, with the keys of that kind.
#[derive(Clone, Debug)]
pub enum LinePathKeys {
    /// See [`SURVEY`].
    Survey(SurveyKeys),
    /// See [`BOX`].
    Box(BoxKeys),
    /// See [`FREE`].
    Free(FreeKeys),
    /// See [`GRID`].
    Grid(GridKeys),
    /// See [`CIRCLE`].
    Circle(CircleKeys),
    /// See [`LOOPING`].
    Looping(LoopingKeys),
    /// See [`LOITER`].
    Loiter(LoiterKeys),
    /// See [`FIGURE_EIGHT`].
    FigureEight(FigureEightKeys),
    /// See [`CLOVERLEAF`].
    Cloverleaf(CloverleafKeys),
}

impl SynthVariantValue for LinePathKeys {
    const DEFAULT: &'static str = "survey";
}

choice! {
    /// A side.
    pub enum PathSide {
        /// To the right, clockwise.
        Right = "right",
        /// To the left, anticlockwise.
        Left = "left",
    }
}

params! {
    /// Waypoints and their heights.
    pub struct WaypointKeys;
    /// Two or more positions [latitude, longitude].
    waypoints: Vec<[f64; 2]>, unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Height above the WGS-84 ellipsoid at each waypoint. It replaces `alt_m`.
    alts_m: Option<Vec<f64>>, unit "m", absent "`alt_m` everywhere", rule Rule::Between(-1000.0, 30_000.0);
    /// Treats `alts_m` as a surface above which the aircraft stays. Climbs begin early enough for `climb_mps` of
    /// `dynamics`. If false, the heights are flown exactly.
    drape: bool, unit "", default false;
}

params! {
    /// A circle and its start.
    pub struct OrbitKeys;
    /// Centre, [latitude, longitude].
    center: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Azimuth of the start as seen from the centre, clockwise from true north.
    from_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Direction of the turns.
    direction: PathSide, unit "", default PathSide::Right;
}

variant! {
    /// Flies from waypoint to waypoint, and repeats the route until `duration_s` has passed.
    SURVEY: LinePathKeys = "survey", |keys| LinePathKeys::Survey(keys);
    struct SurveyKeys, groups [route: WaypointKeys];
    /// Duration of the line.
    duration_s: f64, unit "s", rule Rule::Between(1.0, 1e5);
    /// Amplitude of a periodic change in course on each leg.
    weave_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 45.0);
    /// Period of that change.
    weave_period_s: f64, unit "s", default 120.0, rule Rule::Positive;
}

variant! {
    /// Flies the waypoints once.
    FREE: LinePathKeys = "free", |keys| LinePathKeys::Free(keys);
    struct FreeKeys, groups [route: WaypointKeys];
}

variant! {
    /// Flies the sides of a square, each with a pitch, a roll and a yaw manoeuvre.
    BOX: LinePathKeys = "box", |keys| LinePathKeys::Box(keys);
    struct BoxKeys;
    /// Start, [latitude, longitude].
    start: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Course of the first leg, clockwise from true north. Turns are to the right.
    heading_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Amplitudes of roll, pitch and yaw (Gnadt 2022, Figure 3-7). An amplitude of 0 omits the manoeuvre.
    amplitude_deg: [f64; 3], unit "deg", default [9.0, 4.5, 5.0], rule Rule::Between(0.0, 40.0);
    /// Period of a manoeuvre.
    period_s: f64, unit "s", default 6.0, rule Rule::Between(1.0, 60.0);
    /// Number of periods of a manoeuvre.
    cycles: usize, unit "", default 3usize, rule Rule::Between(1.0, 100.0);
    /// Number of legs.
    legs: usize, unit "", default 4usize, rule Rule::Between(1.0, 64.0);
    /// First and last of the sets of manoeuvres in Gnadt 2022, Table 5.7. Each set is one line. The sets replace
    /// `amplitude_deg` and `cycles`.
    sets: Option<[usize; 2]>, unit "", absent "`amplitude_deg` and `cycles`", rule Rule::Between(1.0, 18.0);
}

variant! {
    /// Flies survey lines in alternating directions, then tie lines across them. With `split`, the survey lines are
    /// named `NAME.01`, `NAME.02`... and the tie lines `NAME.T01`... The lines keep their order and times; turns are
    /// omitted.
    GRID: LinePathKeys = "grid", |keys| LinePathKeys::Grid(keys);
    struct GridKeys;
    /// Start of the first line, [latitude, longitude].
    origin: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Course of the first line, clockwise from true north.
    heading_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Length of a line.
    line_m: f64, unit "m", rule Rule::Between(1.0, 1e6);
    /// Distance between adjacent survey lines.
    spacing_m: f64, unit "m", rule Rule::Between(0.1, 1e5);
    /// Number of survey lines.
    count: usize, unit "", default 1usize, rule Rule::Between(1.0, 10_000.0);
    /// Distance between adjacent tie lines.
    tie_spacing_m: Option<f64>, unit "m", absent "no tie lines", rule Rule::Between(1.0, 1e6);
    /// Side of the first line on which the others lie.
    side: PathSide, unit "", default PathSide::Right;
    /// Splits the grid into separate lines. If false, the grid with its turns is one line.
    split: bool, unit "", default true;
}

variant! {
    /// Circles a position.
    CIRCLE: LinePathKeys = "circle", |keys| LinePathKeys::Circle(keys);
    struct CircleKeys, groups [orbit: OrbitKeys];
    /// Number of turns.
    turns: f64, unit "1", default 1.0, rule Rule::Between(0.01, 1000.0);
}

variant! {
    /// Circles a position while climbing, then while descending.
    LOOPING: LinePathKeys = "looping", |keys| LinePathKeys::Looping(keys);
    struct LoopingKeys, groups [orbit: OrbitKeys];
    /// Number of turns during the climb, and again during the descent.
    turns: f64, unit "1", default 1.0, rule Rule::Between(0.1, 100.0);
    /// Number of climbs, each followed by a descent.
    rounds: usize, unit "", default 1usize, rule Rule::Between(1.0, 100.0);
    /// Maximum height above the WGS-84 ellipsoid.
    top_m: f64, unit "m", rule Rule::Between(-1000.0, 30_000.0);
}

variant! {
    /// Flies a racetrack of two straights and two half circles.
    LOITER: LinePathKeys = "loiter", |keys| LinePathKeys::Loiter(keys);
    struct LoiterKeys;
    /// Start of the first straight, [latitude, longitude].
    start: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Course of the first straight, clockwise from true north.
    heading_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Length of a straight.
    leg_m: f64, unit "m", default 2000.0, rule Rule::Between(0.0, 1e6);
    /// Number of rounds.
    rounds: usize, unit "", default 1usize, rule Rule::Between(1.0, 1000.0);
    /// Direction of the turns.
    direction: PathSide, unit "", default PathSide::Right;
}

variant! {
    /// Flies two loops that cross at a right angle, one to the right and one to the left.
    FIGURE_EIGHT: LinePathKeys = "figure_eight", |keys| LinePathKeys::FigureEight(keys);
    struct FigureEightKeys;
    /// Position of the crossing, [latitude, longitude].
    center: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Course of the first crossing, clockwise from true north.
    heading_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Number of rounds.
    rounds: usize, unit "", default 1usize, rule Rule::Between(1.0, 1000.0);
}

variant! {
    /// Crosses one position on four courses, 90 degrees apart.
    CLOVERLEAF: LinePathKeys = "cloverleaf", |keys| LinePathKeys::Cloverleaf(keys);
    struct CloverleafKeys;
    /// Position of the crossings, [latitude, longitude].
    center: [f64; 2], unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Course of the first crossing, clockwise from true north.
    heading_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Number of crossings.
    crossings: usize, unit "", default 4usize, rule Rule::Between(1.0, 1000.0);
    /// Direction of the turns.
    direction: PathSide, unit "", default PathSide::Right;
}

/// The kinds of lines.
pub(in super::super) fn kinds() -> ChoiceRegistry {
    let all = vec![&SURVEY, &BOX, &FREE, &GRID, &CIRCLE, &LOOPING, &LOITER, &FIGURE_EIGHT, &CLOVERLEAF];
    ChoiceRegistry::default().with(all)
}

params! {
    /// A table of `flights.lines`: one or more lines.
    pub struct LineKeys;
    /// Identifier of the line.
    name: String, unit "";
    /// Kind of the path.
    kind: ChoiceSelection<SynthVariant<LinePathKeys>>, unit "";
    /// Start of the line, in seconds past midnight UTC. The first line defaults to the flight's `start_tt_s`.
    start_tt_s: Option<f64>, unit "s", absent "60 s after the end of the previous line", rule Rule::NotNegative;
    /// Height above the WGS-84 ellipsoid.
    alt_m: f64, unit "m", rule Rule::Between(-1000.0, 30_000.0);
    /// Airspeed. Without wind it equals the speed over ground.
    speed_mps: f64, unit "m/s", default 60.0, rule Rule::Between(1.0, 1000.0);
    /// Radius of turns and circles.
    radius_m: Option<f64>, unit "m", absent "the smallest radius that `bank_deg` of `dynamics` allows",
        rule Rule::Between(1.0, 1e6);
}

params! {
    /// A table of `flights`: a flight. Each of its tables `lines` defines one or more lines.
    pub struct FlightKeys;
    /// Identifier of the flight.
    name: String, unit "";
    /// Start of the first line, in seconds past midnight UTC.
    start_tt_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Number of flights in a Monte Carlo study. They share the flight plan and the aircraft; all other random draws
    /// are independent. The flights are named `<name>-1`, `<name>-2`, and so on.
    copies: Option<usize>, unit "", absent "one flight, named `name`", rule Rule::Between(1.0, 10_000.0);
}

/// The lines of one table `flights.lines`.
fn lines(s: &SynthSection, next_s: f64, air: &FlightConditions) -> Vec<SynthLine> {
    let faults = s.faults();
    let Some(keys) = s.group_of::<LineKeys>(None, &kinds()) else { return vec![] };
    s.refuse_foreign(&keys.kind);
    let common = SynthLine {
        name: keys.name,
        start_tt_s: keys.start_tt_s.unwrap_or(next_s),
        alt_m: keys.alt_m,
        speed_mps: keys.speed_mps,
        // Lines of the kinds `survey` and `free` also have a radius.
        radius_m: keys.radius_m,
        heights: LineHeights::default(),
        path: HorizontalPath::Free { waypoints: vec![] },
        plan: TrajectoryPlan::default(),
    };
    let one = |path: HorizontalPath| vec![SynthLine { path, ..common.clone() }];
    let orbit = |keys: &OrbitKeys| Orbit {
        center: position(s, "center", keys.center),
        from_deg: keys.from_deg,
        right: keys.direction == PathSide::Right,
    };
    let found = match &*keys.kind.keys {
        LinePathKeys::Survey(keys) => {
            let (waypoints, heights) = waypoints(s, &keys.route);
            let weave_deg_s = (keys.weave_deg, keys.weave_period_s);
            let path = HorizontalPath::Survey { waypoints, duration_s: keys.duration_s, weave_deg_s };
            vec![SynthLine { path, heights, ..common.clone() }]
        }
        LinePathKeys::Free(keys) => {
            let (waypoints, heights) = waypoints(s, &keys.route);
            vec![SynthLine { path: HorizontalPath::Free { waypoints }, heights, ..common.clone() }]
        }
        LinePathKeys::Box(keys) => boxes(s, keys, &common),
        LinePathKeys::Grid(keys) => return grid(s, keys, &common, air, faults),
        LinePathKeys::Circle(keys) => one(HorizontalPath::Circle { orbit: orbit(&keys.orbit), turns: keys.turns }),
        LinePathKeys::Looping(keys) => one(HorizontalPath::Looping {
            orbit: orbit(&keys.orbit),
            turns: keys.turns,
            rounds: keys.rounds as u32,
            top_m: keys.top_m,
        }),
        LinePathKeys::Loiter(keys) => one(HorizontalPath::Loiter {
            start: position(s, "start", keys.start),
            heading_deg: keys.heading_deg,
            leg_m: keys.leg_m,
            rounds: keys.rounds as u32,
            right: keys.direction == PathSide::Right,
        }),
        LinePathKeys::FigureEight(keys) => one(HorizontalPath::FigureEight {
            center: position(s, "center", keys.center),
            heading_deg: keys.heading_deg,
            rounds: keys.rounds as u32,
        }),
        LinePathKeys::Cloverleaf(keys) => one(HorizontalPath::Cloverleaf {
            center: position(s, "center", keys.center),
            heading_deg: keys.heading_deg,
            crossings: keys.crossings as u32,
            right: keys.direction == PathSide::Right,
        }),
    };
    // A line with invalid values is not flown and is reported once.
    if s.faults() > faults { found } else { planned(s, found, air) }
}

/// Plans lines that follow each other.
fn planned(s: &SynthSection, mut lines: Vec<SynthLine>, air: &FlightConditions) -> Vec<SynthLine> {
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

impl SynthLine {
    fn planned(&self, air: &FlightConditions) -> Result<TrajectoryPlan, RouteError> {
        TrajectoryPlan::new(&TrajectoryRequest {
            path: &self.path,
            alt_m: self.alt_m,
            heights: &self.heights,
            airspeed_mps: self.speed_mps,
            radius_m: self.radius_m,
            air,
        })
    }
}

fn waypoints(s: &SynthSection, keys: &WaypointKeys) -> (Vec<(f64, f64)>, LineHeights) {
    let WaypointKeys { waypoints: given, alts_m, drape } = keys;
    if given.len() < 2 || given.iter().any(|[lat, _]| lat.abs() >= 89.0) {
        let what = "`waypoints` of `lines` must be a list of two or more [latitude, longitude] in degrees";
        s.fault_at("waypoints", what.to_owned());
    }
    if alts_m.as_ref().is_some_and(|alts| alts.len() != given.len()) {
        s.fault_at("alts_m", format!("`alts_m` must have one height for each of the {} waypoints", given.len()));
    }
    if *drape && alts_m.is_none() {
        s.fault_at("drape", "`drape` needs `alts_m`, the heights of the surface at the waypoints".to_owned());
    }
    (given.iter().map(|[lat, lon]| (*lat, *lon)).collect(), LineHeights { alts_m: alts_m.clone(), drape: *drape })
}

/// Table 5.7 of Gnadt 2022: amplitudes of roll, pitch and yaw, in degrees, and periods per manoeuvre of sets 1 to 18.
/// Each angle has 2 or 6 periods; an angle of 0 is not flown.
fn set(number: usize) -> ([f64; 3], u32) {
    let (group, scale) = ((number - 1) / 3, [1.0, 2.0, 4.0][(number - 1) % 3]);
    let (roll, yaw) = (if group >= 2 { 5.0 } else { 0.0 }, if group >= 4 { 2.5 } else { 0.0 });
    ([roll * scale, 2.5 * scale, yaw * scale], if group % 2 == 0 { 2 } else { 6 })
}

/// `kind = "box"`. `sets = [first, last]` selects sets of Gnadt 2022, table 5.7, one line each.
fn boxes(s: &SynthSection, keys: &BoxKeys, common: &SynthLine) -> Vec<SynthLine> {
    let start = position(s, "start", keys.start);
    let (heading_deg, period_s, legs) = (keys.heading_deg, keys.period_s, keys.legs as u32);
    let path =
        |amplitude_deg, cycles| HorizontalPath::Box { start, heading_deg, amplitude_deg, period_s, cycles, legs };
    let Some([first, last]) = keys.sets else {
        return vec![SynthLine { path: path(keys.amplitude_deg, keys.cycles as u32), ..common.clone() }];
    };
    if first > last {
        s.fault_at("sets", "`sets` must be two whole numbers in ascending order, such as [1, 18]".to_owned());
    }
    let several = first < last;
    let one = |number: usize| {
        let (amplitude_deg, cycles) = set(number);
        let name = if several { format!("{}.{number:02}", common.name) } else { common.name.clone() };
        SynthLine { name, path: path(amplitude_deg, cycles), ..common.clone() }
    };
    (first..=last).map(one).collect()
}

/// `kind = "grid"`; `faults` is the number of faults before the table.
fn grid(
    s: &SynthSection,
    keys: &GridKeys,
    common: &SynthLine,
    air: &FlightConditions,
    faults: usize,
) -> Vec<SynthLine> {
    let grid = SurveyLineGrid {
        origin: position(s, "origin", keys.origin),
        heading_deg: keys.heading_deg,
        line_m: keys.line_m,
        spacing_m: keys.spacing_m,
        count: keys.count as u32,
        tie_spacing_m: keys.tie_spacing_m,
        right: keys.side == PathSide::Right,
    };
    let whole = SynthLine { path: HorizontalPath::Grid(grid), ..common.clone() };
    if s.faults() > faults {
        return vec![whole];
    }
    let whole = planned(s, vec![whole], air);
    let Some(unsplit) = whole.first().filter(|_| keys.split) else { return whole };
    let (mut numbers, mut lines) = ([0, 0], vec![]);
    for (stretch, start_s) in grid.stretches().iter().zip(&unsplit.plan.marks_s) {
        let number = &mut numbers[usize::from(stretch.tie)];
        *number += 1;
        let name = format!("{}.{}{number:02}", common.name, if stretch.tie { "T" } else { "" });
        let (start, heading_deg) = (stretch.start.degrees(), stretch.start.course_rad.to_degrees());
        let path = HorizontalPath::Traverse { start, heading_deg, length_m: stretch.length_m };
        let line = SynthLine { name, path, start_tt_s: common.start_tt_s + start_s, ..common.clone() };
        lines.extend(planned(s, vec![line], air));
    }
    lines
}

/// A position in degrees; a pole is rejected.
fn position(s: &SynthSection, key: &'static str, [lat, lon]: [f64; 2]) -> (f64, f64) {
    if lat.abs() >= 89.0 {
        s.fault_at(
            key,
            format!("`{key}` of `lines` must be [latitude, longitude] in degrees, with a latitude below 89 degrees"),
        );
    }
    (lat, lon)
}
