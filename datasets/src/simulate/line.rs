//! One line: truth, INS, the earth's field and what every sensor reads.

use std::path::Path;

use nalgebra::Vector3;
use stages::numerics::{
    attitude::{body_to_ned, euler_rad, tilted},
    core_field::CoreField,
    dates::decimal_year,
    ins_error::simulate_ins_error,
    ins_series::InsSeries,
    map_grid::AnomalyMap,
    pinson::{ACC, LAT, TILT_N, VN},
};

use super::{
    aircraft::{Field, Surroundings, switched},
    random::Random,
    spec::{Flight, Line, Spec},
    trajectory::Trajectory,
};
use crate::{
    ReadError,
    motion::derivative,
    table::{Table, Values},
};

/// A line about to be simulated.
pub(super) struct Scene<'a> {
    pub(super) path: &'a Path,
    pub(super) spec: &'a Spec,
    pub(super) flight: &'a Flight,
    pub(super) line: &'a Line,
}

impl Scene<'_> {
    /// The stream of random numbers of one thing on this line.
    fn random(&self, what: &str) -> Random {
        Random::of(self.spec.seed, &["line", &self.flight.name, &self.line.name, what])
    }

    fn fault(&self, what: String) -> ReadError {
        ReadError::options(self.path, format!("flight {}, line {}: {what}", self.flight.name, self.line.name))
    }

    /// Simulates the line over a map of the anomaly at its height.
    pub(super) fn simulate(&self, anomaly: &AnomalyMap) -> Result<Table, ReadError> {
        let spec = self.spec;
        let truth = self.line.fly(spec.rate_hz, spec.gusts_deg, &mut self.random("gusts"));
        let mut table = self.truth(&truth);
        self.push_ins(&mut table, &truth)?;
        let earth = self.earth(&truth, anomaly)?;
        table.push("diurnal", "", Values::Number(earth.diurnal_nt.clone()));
        table.push("igrf", "", Values::Number(earth.core_nt.clone()));
        self.push_sensors(&mut table, &truth, &earth);
        Ok(table)
    }

    fn truth(&self, truth: &Trajectory) -> Table {
        let rows = truth.tt_s.len();
        let mut table = Table::default();
        table.push("flight", "", Values::Text(vec![self.flight.name.clone(); rows]));
        table.push("line", "", Values::Text(vec![self.line.name.clone(); rows]));
        let (year, doy) = self.spec.date;
        table.push("year", "", Values::Whole(vec![Some(i64::from(year)); rows]));
        table.push("doy", "", Values::Whole(vec![Some(i64::from(doy)); rows]));
        let mut number = |name: &str, x: &[f64]| table.push(name, "", Values::Number(x.to_vec()));
        number("tt", &truth.tt_s);
        number("lat", &truth.lat_deg);
        number("lon", &truth.lon_deg);
        number("alt", &truth.alt_m);
        for (name, x) in ["vn", "ve", "vd"].iter().zip(&truth.velocity_mps) {
            number(name, x);
        }
        for (name, x) in ["roll", "pitch", "yaw"].iter().zip(&truth.attitude_deg) {
            number(name, x);
        }
        table
    }

    /// INS = truth - error, aligned anew at the start of the line.
    fn push_ins(&self, table: &mut Table, truth: &Trajectory) -> Result<(), ReadError> {
        let mut random = self.random("ins");
        let errors = simulate_ins_error(&series(truth), &self.spec.ins, || random.normal());
        let errors = errors.map_err(|e| self.fault(e.to_string()))?;
        let names = [
            "ins_lat",
            "ins_lon",
            "ins_alt",
            "ins_vn",
            "ins_ve",
            "ins_vd",
            "ins_roll",
            "ins_pitch",
            "ins_yaw",
            "ins_fn",
            "ins_fe",
            "ins_fd",
        ];
        let mut columns: [Vec<f64>; 12] = Default::default();
        for (i, e) in errors.iter().enumerate() {
            let c = attitude(truth, i);
            let c_ins = tilted(&c, &-Vector3::new(e[TILT_N], e[TILT_N + 1], e[TILT_N + 2]));
            let f = Vector3::from_fn(|k, _| truth.force_mps2[k][i]);
            // The accelerometers' error is truth minus measurement, too.
            let f_ins = c_ins * (c.transpose() * f - Vector3::new(e[ACC], e[ACC + 1], e[ACC + 2]));
            let (roll, pitch, yaw) = euler_rad(&c_ins);
            let row = [
                truth.lat_deg[i] - e[LAT].to_degrees(),
                truth.lon_deg[i] - e[LAT + 1].to_degrees(),
                truth.alt_m[i] - e[LAT + 2],
                truth.velocity_mps[0][i] - e[VN],
                truth.velocity_mps[1][i] - e[VN + 1],
                truth.velocity_mps[2][i] - e[VN + 2],
                roll.to_degrees(),
                pitch.to_degrees(),
                yaw.to_degrees(),
                f_ins.x,
                f_ins.y,
                f_ins.z,
            ];
            columns.iter_mut().zip(row).for_each(|(column, x)| column.push(x));
        }
        for (name, column) in names.into_iter().zip(columns) {
            table.push(name, "", Values::Number(column));
        }
        Ok(())
    }

    /// The earth's field: core plus anomaly and diurnal variation along the core's direction, so that its
    /// magnitude is their exact sum. The core field is that of the line's first sample in time.
    fn earth(&self, truth: &Trajectory, anomaly: &AnomalyMap) -> Result<Earth, ReadError> {
        let (year, doy) = self.spec.date;
        let date = decimal_year(year, doy, self.line.start_tt_s).map_err(|e| self.fault(e.to_string()))?;
        let core = CoreField::at(date).map_err(|e| self.fault(e.to_string()))?;
        let mut random = self.random("diurnal");
        let diurnal = self.spec.diurnal.map(|d| d.realisation(&truth.tt_s, || random.normal()));
        let diurnal_nt = diurnal.unwrap_or_else(|| vec![0.0; truth.tt_s.len()]);
        let mut earth = Earth { core_nt: vec![], diurnal_nt, body_nt: vec![] };
        for i in 0..truth.tt_s.len() {
            let (lat, lon) = (truth.lat_deg[i], truth.lon_deg[i]);
            let local = anomaly.at(lat, lon).ok_or_else(|| {
                let since = truth.tt_s[i] - self.line.start_tt_s;
                self.fault(format!("leaves the known map after {since:.1} s, at {lat:.5}, {lon:.5}"))
                    .help("move the waypoints inwards or shorten the line")
            })?;
            let core = Vector3::from(core.field_ned_nt(lat, lon, truth.alt_m[i]));
            let total = core.norm() + local.value_nt + earth.diurnal_nt[i];
            earth.core_nt.push(core.norm());
            earth.body_nt.push(attitude(truth, i).transpose() * (core.normalize() * total));
        }
        Ok(earth)
    }

    fn push_sensors(&self, table: &mut Table, truth: &Trajectory, earth: &Earth) {
        let spec = self.spec;
        let parts: [Vec<f64>; 3] = std::array::from_fn(|k| {
            let component: Vec<f64> = earth.body_nt.iter().map(|b| b[k]).collect();
            derivative(&truth.tt_s, &component)
        });
        let rate_ntps: Vec<_> = (0..truth.tt_s.len()).map(|i| Vector3::from_fn(|k, _| parts[k][i])).collect();
        let amperes: Vec<Vec<f64>> =
            spec.currents.iter().map(|c| switched(c, &truth.tt_s, &mut self.random(&c.name))).collect();
        let around =
            Surroundings { tt_s: &truth.tt_s, body_nt: &earth.body_nt, rate_ntps: &rate_ntps, amperes: &amperes };
        for sensor in &spec.scalars {
            let field = Field::draw(spec.seed, &sensor.name, &sensor.source, &spec.currents);
            let values = around.scalar_nt(sensor, &field, &mut self.random(&sensor.name));
            table.push(&sensor.name, "", Values::Number(values));
        }
        for sensor in &spec.vectors {
            let field = Field::draw(spec.seed, &sensor.name, &sensor.source, &spec.currents);
            let axes = around.vector_nt(sensor, &field, spec.seed, &mut self.random(&sensor.name));
            for (axis, values) in ["x", "y", "z"].iter().zip(axes) {
                table.push(&format!("{}_{axis}", sensor.name), "", Values::Number(values));
            }
        }
        for (current, true_a) in spec.currents.iter().zip(&amperes) {
            let mut random = self.random(&format!("sensor of {}", current.name));
            let values = true_a.iter().map(|a| a + current.noise_a * random.normal()).collect();
            table.push(&current.name, "", Values::Number(values));
        }
    }
}

/// The earth's field along a line, in nT.
struct Earth {
    core_nt: Vec<f64>,
    diurnal_nt: Vec<f64>,
    body_nt: Vec<Vector3<f64>>,
}

fn attitude(truth: &Trajectory, i: usize) -> nalgebra::Matrix3<f64> {
    let [roll, pitch, yaw] = truth.attitude_deg.each_ref().map(|a| a[i].to_radians());
    body_to_ned(roll, pitch, yaw)
}

fn series(truth: &Trajectory) -> InsSeries<'_> {
    let ([vn, ve, vd], [f_n, f_e, f_d]) = (&truth.velocity_mps, &truth.force_mps2);
    let [roll, pitch, yaw] = &truth.attitude_deg;
    InsSeries {
        tt_s: &truth.tt_s,
        lat_deg: &truth.lat_deg,
        lon_deg: &truth.lon_deg,
        alt_m: &truth.alt_m,
        vn_mps: vn,
        ve_mps: ve,
        vd_mps: vd,
        fn_mps2: f_n,
        fe_mps2: f_e,
        fd_mps2: f_d,
        roll_deg: roll,
        pitch_deg: pitch,
        yaw_deg: yaw,
    }
}
