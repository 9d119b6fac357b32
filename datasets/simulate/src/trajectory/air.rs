//! The air, and the performance of the aircraft.

use schemas::{Rule, choice, params};

use crate::reading::SynthSection;

/// One foot, in metres.
const FOOT_M: f64 = 0.3048;
/// Standard gravity, for the design of turns, in m/s².
pub(super) const GRAVITY_MPS2: f64 = 9.806_65;

params! {
    /// The table `wind`: a horizontal wind that may change with height. Without it the air is still.
    pub struct Wind, all default;
    /// Wind speed at the height `at_alt_m`.
    speed_mps: f64, unit "m/s", default 0.0, rule Rule::Between(0.0, 100.0);
    /// Direction that the wind blows from at the height `at_alt_m`, clockwise from true north.
    from_deg: f64, unit "deg", default 0.0, rule Rule::Between(-360.0, 360.0);
    /// Height above the WGS-84 ellipsoid at which `speed_mps` and `from_deg` apply.
    at_alt_m: f64, unit "m", default 0.0, rule Rule::Finite;
    /// Change of the wind speed per km of height. The speed does not fall below 0.
    shear_mps_per_km: f64, unit "m/s", default 0.0, rule Rule::Between(-50.0, 50.0);
    /// Clockwise change of the wind direction per km of height.
    veer_deg_per_km: f64, unit "deg", default 0.0, rule Rule::Between(-180.0, 180.0);
}

impl Copy for Wind {}

impl Wind {
    /// Velocity of the air, if it is the same at all heights.
    pub(super) fn same_mps(&self) -> Option<(f64, f64)> {
        match self.speed_mps == 0.0 && self.shear_mps_per_km == 0.0 {
            true => Some((0.0, 0.0)),
            false => (self.shear_mps_per_km == 0.0 && self.veer_deg_per_km == 0.0).then(|| self.at(0.0)),
        }
    }

    /// The air's velocity at a height: north and east, in m/s.
    pub(super) fn at(&self, alt_m: f64) -> (f64, f64) {
        let up_km = (alt_m - self.at_alt_m) * 1e-3;
        let speed = (self.speed_mps + self.shear_mps_per_km * up_km).max(0.0);
        let (sin, cos) = (self.from_deg + self.veer_deg_per_km * up_km).to_radians().sin_cos();
        (-speed * cos, -speed * sin)
    }
}

/// The table `turbulence`: continuous random gusts after Dryden. Without turbulence, the air is smooth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turbulence {
    /// Wind speed 20 feet above the ground, in m/s.
    pub wind_20ft_mps: f64,
    /// Height of the ground above the ellipsoid, in metres.
    pub ground_m: f64,
}

/// Standard deviations and scale lengths of the gusts at one height.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GustStatistics {
    /// Along, across and vertical, in m/s.
    pub(super) sigma_mps: [f64; 3],
    /// Scale lengths of the gusts in the same directions, in metres.
    pub(super) length_m: [f64; 3],
}

/// Gusts above 2000 feet: heights in feet, and the standard deviations in ft/s of light, moderate and severe turbulence
/// at these heights (exceeded with a probability of 1e-2, 1e-3 and 1e-5). [MIL-F-8785C, figure 7]
const HIGH: [(f64, [f64; 3]); 12] = [
    (500.0, [6.6, 8.6, 15.6]),
    (1750.0, [6.9, 9.6, 17.6]),
    (3750.0, [7.4, 10.6, 23.0]),
    (7500.0, [6.7, 10.1, 23.6]),
    (15_000.0, [4.6, 8.0, 22.1]),
    (25_000.0, [2.7, 6.6, 20.0]),
    (35_000.0, [0.4, 5.0, 16.0]),
    (45_000.0, [0.0, 4.2, 15.1]),
    (55_000.0, [0.0, 2.7, 12.1]),
    (65_000.0, [0.0, 0.0, 7.9]),
    (75_000.0, [0.0, 0.0, 6.2]),
    (80_000.0, [0.0, 0.0, 5.1]),
];

impl Turbulence {
    /// The statistics of the gusts at a height. [MIL-F-8785C, 3.7.2 and 3.7.3.4]
    pub(super) fn at(&self, alt_m: f64) -> GustStatistics {
        let h_ft = ((alt_m - self.ground_m) / FOOT_M).max(10.0);
        let w20_ftps = self.wind_20ft_mps / FOOT_M;
        let low = |h_ft: f64| {
            let shape = 0.177 + 0.000_823 * h_ft;
            let sigma = 0.1 * w20_ftps;
            let (across, length) = (sigma / shape.powf(0.4), h_ft / shape.powf(1.2));
            ([across, across, sigma], [length, length, h_ft])
        };
        let high = |h_ft: f64| ([high_ftps(h_ft, w20_ftps); 3], [1750.0; 3]);
        let (sigma, length) = match h_ft {
            h if h <= 1000.0 => low(h),
            h if h >= 2000.0 => high(h),
            h => {
                let (below, above, up) = (low(1000.0), high(2000.0), (h - 1000.0) / 1000.0);
                let mix = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + up * (b[i] - a[i]));
                (mix(below.0, above.0), mix(below.1, above.1))
            }
        };
        GustStatistics { sigma_mps: sigma.map(|x| x * FOOT_M), length_m: length.map(|x| x * FOOT_M) }
    }
}

/// The standard deviation of turbulence well above the ground for a wind at 20 feet, in ft/s. The interpolation is
/// linear in the wind between the three curves, and between calm and the first curve.
fn high_ftps(h_ft: f64, w20_ftps: f64) -> f64 {
    let above = HIGH.iter().position(|(h, _)| *h >= h_ft).unwrap_or(HIGH.len() - 1).max(1);
    let ((h0, low), (h1, high)) = (HIGH[above - 1], HIGH[above]);
    let up = ((h_ft - h0) / (h1 - h0)).clamp(0.0, 1.0);
    let curve = |k: usize| low[k] + up * (high[k] - low[k]);
    let step_ftps = LEVEL_MPS / FOOT_M;
    let place = w20_ftps / step_ftps;
    match place {
        p if p <= 1.0 => p * curve(0),
        p if p <= 2.0 => curve(0) + (p - 1.0) * (curve(1) - curve(0)),
        p => curve(1) + (p - 2.0) * (curve(2) - curve(1)),
    }
}

/// Wind speed at 20 feet for light turbulence, in m/s: 15 knots. The wind speed is twice as high for moderate and three
/// times as high for severe turbulence.
const LEVEL_MPS: f64 = 15.0 * 1852.0 / 3600.0;

params! {
    /// The table `dynamics`: the performance of the aircraft and its response to gusts. The defaults are those of a
    /// light survey aircraft.
    pub struct Dynamics, all default;
    /// Maximum bank angle. If no radius is set, turns are as tight as this angle allows at the downwind ground speed.
    bank_deg: f64, unit "deg", default 25.0, rule Rule::Between(3.0, 70.0);
    /// Maximum roll rate into and out of a turn.
    roll_rate_degps: f64, unit "deg/s", default 10.0, rule Rule::Between(1.0, 180.0);
    /// Maximum rate of climb and descent.
    climb_mps: f64, unit "m/s", default 5.0, rule Rule::Between(0.1, 50.0);
    /// Angle of attack in straight level flight at `cruise_mps`. It is proportional to the load factor and inversely
    /// proportional to the square of the airspeed.
    trim_deg: f64, unit "deg", default 2.0, rule Rule::Between(-5.0, 15.0);
    /// Airspeed at which `trim_deg` applies.
    cruise_mps: Option<f64>, unit "m/s", default None, absent "the line's `speed_mps`", rule Rule::Between(1.0, 1000.0);
    /// Factor on the time constants of the airframe's response to gusts. For a light survey aircraft they are 0.4 s in
    /// roll, 1 s in heave, 2.1 s in the pitch oscillation and 3.1 s in the yaw oscillation. For a small drone, the
    /// factor is about 0.3.
    response_s: f64, unit "s", default 1.0, rule Rule::Between(0.05, 5.0);
    /// Wing span, which determines how strongly gusts roll the aircraft.
    span_m: f64, unit "m", default 11.0, rule Rule::Between(0.3, 100.0);
}

impl Copy for Dynamics {}

impl Dynamics {
    /// The bank, in radians, of a turn of this radius at this speed over ground.
    pub(super) fn bank_rad(radius_m: f64, speed_mps: f64) -> f64 {
        (speed_mps * speed_mps / (radius_m * GRAVITY_MPS2)).atan()
    }

    /// The tightest turn at a speed over ground, in metres.
    pub(super) fn tightest_m(&self, speed_mps: f64) -> f64 {
        speed_mps * speed_mps / (GRAVITY_MPS2 * self.bank_deg.to_radians().tan())
    }

    /// The distance flown while rolling into a turn, in metres: the maximum roll rate of the smooth step is 15/8 of the
    /// mean.
    pub(super) fn ramp_m(&self, radius_m: f64, speed_mps: f64) -> f64 {
        let roll_s = 1.875 * Self::bank_rad(radius_m, speed_mps) / self.roll_rate_degps.to_radians();
        speed_mps * roll_s.max(1.0)
    }
}

/// Wind, turbulence and dynamics of a spec.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlightConditions {
    /// The table `wind`.
    pub wind: Wind,
    /// The table `turbulence`.
    pub turbulence: Option<Turbulence>,
    /// The table `dynamics`.
    pub dynamics: Dynamics,
}

choice! {
    /// Intensity of the turbulence, given by the wind speed 20 feet above the ground.
    pub enum TurbulenceIntensity {
        /// No turbulence.
        None = "none",
        /// 15 knots.
        Light = "light",
        /// 30 knots.
        Moderate = "moderate",
        /// 45 knots.
        Severe = "severe",
    }
}

impl TurbulenceIntensity {
    /// The wind speed 20 feet above the ground, in m/s.
    fn wind_20ft_mps(self) -> f64 {
        match self {
            TurbulenceIntensity::None => 0.0,
            TurbulenceIntensity::Light => LEVEL_MPS,
            TurbulenceIntensity::Moderate => 2.0 * LEVEL_MPS,
            TurbulenceIntensity::Severe => 3.0 * LEVEL_MPS,
        }
    }
}

params! {
    /// The table `turbulence`: continuous random gusts after Dryden (MIL-F-8785C). Without it the air is smooth.
    pub struct TurbulenceKeys, all default;
    /// Intensity of the turbulence.
    level: TurbulenceIntensity, unit "", default TurbulenceIntensity::None;
    /// Wind speed 20 feet above the ground. This wind speed replaces `level`.
    wind_20ft_mps: Option<f64>, unit "m/s", default None, absent "set by `level`", rule Rule::Between(0.0, 40.0);
    /// Height of the ground above the WGS-84 ellipsoid.
    ground_m: f64, unit "m", default 0.0, rule Rule::Finite;
}

/// Reads the three tables.
pub(in super::super) fn air(root: &SynthSection) -> FlightConditions {
    let wind = root.section("wind").and_then(|s| s.group(None)).unwrap_or_default();
    let dynamics = root.section("dynamics").and_then(|s| s.group(None)).unwrap_or_default();
    FlightConditions { wind, turbulence: turbulence(root), dynamics }
}

fn turbulence(root: &SynthSection) -> Option<Turbulence> {
    let keys: TurbulenceKeys = root.section("turbulence")?.group(None)?;
    let wind_20ft_mps = keys.wind_20ft_mps.unwrap_or(keys.level.wind_20ft_mps());
    (wind_20ft_mps > 0.0).then_some(Turbulence { wind_20ft_mps, ground_m: keys.ground_m })
}
