//! What the spec says of the flights: their lines, where these go, and how.

use super::super::spec::{
    section::{Need, Section},
    unique,
};

/// A flight.
#[derive(Clone, Debug)]
pub struct Flight {
    /// Its identifier.
    pub name: String,
    /// Its lines, in time.
    pub lines: Vec<Line>,
}

/// A line of a flight.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its identifier.
    pub name: String,
    /// When it begins, in seconds past midnight UTC.
    pub start_tt_s: f64,
    /// Height above the WGS-84 ellipsoid, in metres.
    pub alt_m: f64,
    /// Speed over ground, in m/s.
    pub speed_mps: f64,
    /// Where it goes.
    pub path: Path2d,
}

/// The horizontal path of a line.
#[derive(Clone, Debug)]
pub enum Path2d {
    /// From waypoint to waypoint, and round again.
    Survey {
        /// Latitude and longitude, in degrees.
        waypoints: Vec<(f64, f64)>,
        /// How long, in seconds.
        duration_s: f64,
        /// Amplitude and period of the course's swing about the way to the next waypoint.
        weave_deg_s: (f64, f64),
    },
    /// Four headings, on each a pitch, a roll and a yaw manoeuvre.
    Box {
        /// Where it begins, in degrees.
        start: (f64, f64),
        /// The first heading; the others follow to the right.
        heading_deg: f64,
        /// Amplitudes of roll, pitch and yaw.
        amplitude_deg: [f64; 3],
        /// Period of a manoeuvre.
        period_s: f64,
        /// Periods to a manoeuvre.
        cycles: u32,
    },
}

/// Reads the flights.
pub(in super::super) fn flights(root: &Section) -> Vec<Flight> {
    let flights: Vec<_> = root.sections("flights").iter().map(flight).collect();
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

fn flight(s: &Section) -> Flight {
    let name = s.text("name");
    let mut next_s = s.number("start_tt_s", 0.0, Need::NotNegative);
    let mut lines = vec![];
    for one in s.sections("lines") {
        let line = line(&one, next_s);
        if line.start_tt_s < next_s - PAUSE_S {
            one.fault_at("start_tt_s", "the line starts before the one before it ends".to_owned());
        }
        next_s = line.start_tt_s + line.duration_s() + PAUSE_S;
        lines.push(line);
    }
    s.finish();
    Flight { name, lines }
}

fn line(s: &Section, next_s: f64) -> Line {
    let path = match s.word("kind", &["survey", "box"]) {
        0 => Path2d::Survey {
            waypoints: s.places("waypoints"),
            duration_s: s.needed("duration_s", Need::Between(1.0, 1e5)),
            weave_deg_s: (
                s.number("weave_deg", 0.0, Need::Between(0.0, 45.0)),
                s.number("weave_period_s", 120.0, Need::Positive),
            ),
        },
        _ => Path2d::Box {
            start: {
                let [lat, lon] = s.numbers("start", [f64::NAN; 2], Need::Between(-360.0, 360.0));
                if lat.is_nan() || lat.abs() >= 89.0 {
                    s.fault("`lines` of kind `box` needs `start`, its [latitude, longitude] in degrees".to_owned());
                }
                (lat, lon)
            },
            heading_deg: s.number("heading_deg", 0.0, Need::Between(-360.0, 360.0)),
            // Figure 3-7 of the thesis: 4.5 degrees of pitch, 9 of roll, 5 of yaw, 6 s.
            amplitude_deg: s.numbers("amplitude_deg", [9.0, 4.5, 5.0], Need::Between(0.0, 40.0)),
            period_s: s.number("period_s", 6.0, Need::Between(1.0, 60.0)),
            cycles: s.whole("cycles", 3, 1, 100) as u32,
        },
    };
    let line = Line {
        name: s.text("name"),
        start_tt_s: s.number("start_tt_s", next_s, Need::NotNegative),
        alt_m: s.needed("alt_m", Need::Any),
        speed_mps: s.number("speed_mps", 60.0, Need::Between(1.0, 1000.0)),
        path,
    };
    s.finish();
    line
}
