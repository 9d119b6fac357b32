//! The air, and the performance of the aircraft.

use super::super::spec::section::{Need, Section};

/// One foot, in metres.
const FOOT_M: f64 = 0.3048;
/// Standard gravity, for the design of turns, in m/s².
pub(super) const GRAVITY_MPS2: f64 = 9.806_65;

/// The table `wind`: a horizontal wind that may change with height. Without it the air is still.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wind {
    /// `speed_mps`: speed at the height `at_alt_m`, in m/s; 0 to 100, 0 where left out.
    pub speed_mps: f64,
    /// `from_deg`: its direction of origin there, clockwise from true north, in degrees; 0 where left out.
    pub from_deg: f64,
    /// `at_alt_m`: the height above the ellipsoid at which speed and direction apply, in metres; 0 where left out.
    pub at_alt_m: f64,
    /// `shear_mps_per_km`: how much stronger it is for each kilometre higher, in m/s; -50 to 50, 0 where left out.
    /// A wind that would reverse is zero.
    pub shear_mps_per_km: f64,
    /// `veer_deg_per_km`: how much it turns clockwise for each kilometre higher, in degrees; 0 where left out.
    pub veer_deg_per_km: f64,
}

impl Wind {
    /// The air's velocity where it is the same at all heights.
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

/// The table `turbulence`: the continuous random gusts of Dryden. Without it the air is smooth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turbulence {
    /// `wind_20ft_mps`: wind 20 feet above the ground, in m/s; 0 to 40. Or `level`: `none`, `light` (15 knots),
    /// `moderate` (30 knots), `severe` (45 knots).
    pub wind_20ft_mps: f64,
    /// `ground_m`: height of the ground above the ellipsoid, in metres; 0 where left out.
    pub ground_m: f64,
}

/// Standard deviations and scale lengths of the gusts at one height.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Gustiness {
    /// Along, across and vertical, in m/s.
    pub(super) sigma_mps: [f64; 3],
    /// Scale lengths of the same, in metres.
    pub(super) length_m: [f64; 3],
}

/// Gusts above 2000 feet: heights in feet, and the standard deviations in ft/s that light, moderate and
/// severe turbulence have there (exceeded with a probability of 1e-2, 1e-3 and 1e-5).
/// [MIL-F-8785C, figure 7]
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
    pub(super) fn at(&self, alt_m: f64) -> Gustiness {
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
        Gustiness { sigma_mps: sigma.map(|x| x * FOOT_M), length_m: length.map(|x| x * FOOT_M) }
    }
}

/// The standard deviation well above the ground of turbulence with this wind at 20 feet, in ft/s: between the
/// three curves in proportion to the wind, as between calm and the first.
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

/// Wind at 20 feet of light turbulence, 15 knots, in m/s; twice that for moderate, three times for severe.
const LEVEL_MPS: f64 = 15.0 * 1852.0 / 3600.0;

/// The table `dynamics`: the performance of the aircraft, and its response to gusts. The defaults are those of a light
/// survey aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    /// `bank_deg`: steepest bank of a turn, in degrees; 3 to 70, 25 where left out. Turns without a radius of their
    /// own are as tight as it allows downwind.
    pub bank_deg: f64,
    /// `roll_rate_degps`: fastest roll into and out of a turn, in deg/s; 1 to 180, 10 where left out.
    pub roll_rate_degps: f64,
    /// `climb_mps`: fastest climb and descent, in m/s; 0.1 to 50, 5 where left out.
    pub climb_mps: f64,
    /// `trim_deg`: angle of attack in straight level flight at `cruise_mps`, in degrees; -5 to 15, 2 where left out.
    pub trim_deg: f64,
    /// `cruise_mps`: airspeed at which the trim applies, in m/s; each line's own where left out. The angle of
    /// attack is in proportion to the load factor and to the inverse square of the airspeed.
    pub cruise_mps: Option<f64>,
    /// `response_s`: the response of the airframe to gusts: its time constants in units of those of a light
    /// survey aircraft (roll 0.4 s, heave 1 s, pitch oscillation 2.1 s, yaw oscillation 3.1 s); 0.05 to 5, 1 where
    /// left out; about 0.3 for a small drone.
    pub response_s: f64,
    /// `span_m`: wing span, in metres, over which gusts roll the aircraft; 0.3 to 100, 11 where left out.
    pub span_m: f64,
}

impl Default for Dynamics {
    fn default() -> Self {
        Self {
            bank_deg: 25.0,
            roll_rate_degps: 10.0,
            climb_mps: 5.0,
            trim_deg: 2.0,
            cruise_mps: None,
            response_s: 1.0,
            span_m: 11.0,
        }
    }
}

impl Dynamics {
    /// The bank, in radians, of a turn of this radius at this speed over ground.
    pub(super) fn bank_rad(radius_m: f64, speed_mps: f64) -> f64 {
        (speed_mps * speed_mps / (radius_m * GRAVITY_MPS2)).atan()
    }

    /// The tightest turn at a speed over ground, in metres.
    pub(super) fn tightest_m(&self, speed_mps: f64) -> f64 {
        speed_mps * speed_mps / (GRAVITY_MPS2 * self.bank_deg.to_radians().tan())
    }

    /// The distance flown while rolling into a turn, in metres: the roll rate of the smooth
    /// step in between is 15/8 of the mean.
    pub(super) fn ramp_m(&self, radius_m: f64, speed_mps: f64) -> f64 {
        let roll_s = 1.875 * Self::bank_rad(radius_m, speed_mps) / self.roll_rate_degps.to_radians();
        speed_mps * roll_s.max(1.0)
    }
}

/// Wind, turbulence and dynamics of a spec.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Air {
    /// The table `wind`.
    pub wind: Wind,
    /// The table `turbulence`.
    pub turbulence: Option<Turbulence>,
    /// The table `dynamics`.
    pub dynamics: Dynamics,
}

/// Reads the three tables.
pub(in super::super) fn air(root: &Section) -> Air {
    Air { wind: wind(root), turbulence: turbulence(root), dynamics: dynamics(root) }
}

fn wind(root: &Section) -> Wind {
    let Some(s) = root.section("wind") else { return Wind::default() };
    let wind = Wind {
        speed_mps: s.number("speed_mps", 0.0, Need::Between(0.0, 100.0)),
        from_deg: s.number("from_deg", 0.0, Need::Between(-360.0, 360.0)),
        at_alt_m: s.number("at_alt_m", 0.0, Need::Any),
        shear_mps_per_km: s.number("shear_mps_per_km", 0.0, Need::Between(-50.0, 50.0)),
        veer_deg_per_km: s.number("veer_deg_per_km", 0.0, Need::Between(-180.0, 180.0)),
    };
    s.finish();
    wind
}

fn turbulence(root: &Section) -> Option<Turbulence> {
    let s = root.section("turbulence")?;
    let level = s.word("level", &["none", "light", "moderate", "severe"]) as f64 * LEVEL_MPS;
    let turbulence = Turbulence {
        wind_20ft_mps: s.number("wind_20ft_mps", level, Need::Between(0.0, 40.0)),
        ground_m: s.number("ground_m", 0.0, Need::Any),
    };
    s.finish();
    (turbulence.wind_20ft_mps > 0.0).then_some(turbulence)
}

fn dynamics(root: &Section) -> Dynamics {
    let d = Dynamics::default();
    let Some(s) = root.section("dynamics") else { return d };
    let dynamics = Dynamics {
        bank_deg: s.number("bank_deg", d.bank_deg, Need::Between(3.0, 70.0)),
        roll_rate_degps: s.number("roll_rate_degps", d.roll_rate_degps, Need::Between(1.0, 180.0)),
        climb_mps: s.number("climb_mps", d.climb_mps, Need::Between(0.1, 50.0)),
        trim_deg: s.number("trim_deg", d.trim_deg, Need::Between(-5.0, 15.0)),
        cruise_mps: s.optional("cruise_mps", Need::Between(1.0, 1000.0)),
        response_s: s.number("response_s", d.response_s, Need::Between(0.05, 5.0)),
        span_m: s.number("span_m", d.span_m, Need::Between(0.3, 100.0)),
    };
    s.finish();
    dynamics
}
