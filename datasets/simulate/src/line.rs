//! One line: truth, INS, the earth's field and the readings of every sensor, as the columns of a table.

use datasets::{
    ReadError,
    table::{Table, Values},
};

use super::{aircraft, earth, ins, scene::Scene, trajectory::Trajectory};

/// The earth's field along a line and the readings of the sensors, by column.
pub(super) struct Around {
    earth: [(&'static str, Vec<f64>); 3],
    readings: Vec<(String, Vec<f64>)>,
}

impl Scene<'_> {
    /// The trajectory of the line.
    pub(super) fn fly(&self) -> Trajectory {
        let spec = self.spec;
        let gusts_deg = if spec.components.on("gusts") { spec.gusts_deg } else { [0.0; 3] };
        self.line.fly_on(spec.components.on("turbulence"), spec.rate_hz, gusts_deg, &mut self.random("gusts"))
    }

    /// The columns that depend on the line's own truth alone.
    pub(super) fn around(&self, truth: &Trajectory, field: &earth::Field) -> Result<Around, ReadError> {
        let earth = earth::along(self, truth, field)?;
        let arms = self.spec.aircraft.scalars.iter().map(|sensor| sensor.arm_m);
        let at_arms = arms.map(|arm| arm.map(|arm| earth::at_arm(self, truth, field, &arm)).transpose());
        let at_arms: Vec<_> = at_arms.collect::<Result<_, _>>()?;
        let readings = aircraft::readings(self, truth, &earth, at_arms);
        let earth = [("diurnal", earth.diurnal_nt), ("igrf", earth.core_nt), ("anomaly_truth", earth.anomaly_nt)];
        Ok(Around { earth, readings })
    }

    /// All columns of the line.
    pub(super) fn table(&self, truth: &Trajectory, ins: [Vec<f64>; 13], around: Around) -> Table {
        let mut table = self.truth(truth);
        for (name, column) in ins::COLUMNS.into_iter().zip(ins).chain(around.earth) {
            table.push(name, "", Values::Number(column));
        }
        for (name, column) in around.readings {
            table.push(&name, "", Values::Number(column));
        }
        table
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
        for (name, x) in ["roll_rate", "pitch_rate", "yaw_rate"].iter().zip(&truth.rates_degps) {
            number(name, x);
        }
        table
    }
}
