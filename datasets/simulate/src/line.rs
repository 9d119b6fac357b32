//! One line: truth, INS, the earth's field and the readings of every sensor, as the columns of a table.

use datasets::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

use schemas::flight::{GNSS_POSITION, GNSS_VELOCITY, INS_GRADE};

use super::{aircraft, earth, ins, scene::SynthLineContext, trajectory::TrueTrajectory};

/// Columns of the earth's field along a line and of the sensor readings.
pub(super) struct SimulatedColumns {
    earth: [(&'static str, Vec<f64>); 3],
    readings: Vec<(String, Vec<f64>)>,
}

impl SynthLineContext<'_> {
    /// The trajectory of the line.
    pub(super) fn fly(&self) -> TrueTrajectory {
        let spec = self.spec;
        let gusts_deg = if spec.components.on("gusts") { spec.gusts_deg } else { [0.0; 3] };
        self.line.fly_on(spec.components.on("turbulence"), spec.rate_hz, gusts_deg, &mut self.random("gusts"))
    }

    /// The columns that depend only on the truth of the line.
    pub(super) fn around(
        &self,
        truth: &TrueTrajectory,
        field: &earth::EarthFieldModel,
    ) -> Result<SimulatedColumns, ReadError> {
        let earth = earth::along(self, truth, field)?;
        let arms = self.spec.aircraft.scalars.iter().map(|sensor| sensor.arm_m);
        let at_arms = arms.map(|arm| arm.map(|arm| earth::at_arm(self, truth, field, &arm)).transpose());
        let at_arms: Vec<_> = at_arms.collect::<Result<_, _>>()?;
        let readings = aircraft::readings(self, truth, &earth, at_arms);
        let earth = [("diurnal", earth.diurnal_nt), ("igrf", earth.core_nt), ("anomaly_truth", earth.anomaly_nt)];
        Ok(SimulatedColumns { earth, readings })
    }

    /// All columns of the line.
    pub(super) fn table(&self, truth: &TrueTrajectory, ins: [Vec<f64>; 13], around: SimulatedColumns) -> ColumnTable {
        let mut table = self.truth(truth);
        let numbers = |table: &mut ColumnTable, name: &str, column| table.push(name, "", ColumnValues::Number(column));
        ins::COLUMNS.into_iter().zip(ins).for_each(|(name, column)| numbers(&mut table, name, column));
        let grade = self.spec.ins.model.sources.description();
        table.push(INS_GRADE, "", ColumnValues::Text(vec![grade; truth.tt_s.len()]));
        let of_gnss = GNSS_POSITION.into_iter().chain(GNSS_VELOCITY);
        let gnss = self.spec.gnss.iter().flat_map(|gnss| of_gnss.clone().zip(gnss.along(self, truth)));
        gnss.chain(around.earth).for_each(|(name, column)| numbers(&mut table, name, column));
        for (name, column) in around.readings {
            table.push(&name, "", ColumnValues::Number(column));
        }
        table
    }

    fn truth(&self, truth: &TrueTrajectory) -> ColumnTable {
        let rows = truth.tt_s.len();
        let mut table = ColumnTable::default();
        table.push("flight", "", ColumnValues::Text(vec![self.flight.name.clone(); rows]));
        table.push("line", "", ColumnValues::Text(vec![self.line.name.clone(); rows]));
        let (year, doy) = self.spec.date;
        table.push("year", "", ColumnValues::Whole(vec![Some(i64::from(year)); rows]));
        table.push("doy", "", ColumnValues::Whole(vec![Some(i64::from(doy)); rows]));
        let mut number = |name: &str, x: &[f64]| table.push(name, "", ColumnValues::Number(x.to_vec()));
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
