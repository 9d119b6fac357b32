//! A GNSS receiver: position and velocity with white noise, at its own interval.

use schemas::{Rule, params};

use super::{reading::SynthSection, scene::SynthLineContext, trajectory::TrueTrajectory};
use numerics::navigation::ins_error::InsErrorModel;

params! {
    /// The table `gnss`: a receiver whose positions and velocities have white noise.
    pub struct GnssReceiver, all default;
    /// Standard deviation of the position along each horizontal axis.
    sigma_m: f64, unit "m", default 2.0, rule Rule::Positive;
    /// Standard deviation of the height.
    alt_sigma_m: f64, unit "m", default 4.0, rule Rule::Positive;
    /// Standard deviation of each component of the velocity.
    velocity_sigma_mps: f64, unit "m/s", default 0.1, rule Rule::Positive;
    /// Time between successive positions, starting at the first sample of each line. The samples between them have no
    /// position.
    interval_s: f64, unit "s", default 1.0, rule Rule::Positive;
}

/// The receiver of a spec, if it has one.
pub(super) fn gnss(root: &SynthSection) -> Option<GnssReceiver> {
    root.section("gnss")?.group(None)
}

impl GnssReceiver {
    /// Position and velocity along a line, in the order of [`schemas::flight::GNSS_POSITION`] and
    /// [`schemas::flight::GNSS_VELOCITY`]; NaN between two positions.
    pub(super) fn along(&self, scene: &SynthLineContext, truth: &TrueTrajectory) -> [Vec<f64>; 6] {
        let rows = truth.tt_s.len();
        let mut columns: [Vec<f64>; 6] = std::array::from_fn(|_| vec![f64::NAN; rows]);
        let mut noise = scene.random("gnss");
        let earth = InsErrorModel::default().earth;
        let first_s = truth.tt_s.first().copied().unwrap_or_default();
        let mut number = 0.0;
        for row in 0..rows {
            // A microsecond allows for the rounding of time stamps.
            if truth.tt_s[row] - first_s + 1e-6 < number * self.interval_s {
                continue;
            }
            number = ((truth.tt_s[row] - first_s + 1e-6) / self.interval_s).floor() + 1.0;
            let (lat_deg, alt_m) = (truth.lat_deg[row], truth.alt_m[row]);
            let (north_m, east_m) = earth.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
            let values = [
                lat_deg + (self.sigma_m * noise.normal() / north_m).to_degrees(),
                truth.lon_deg[row] + (self.sigma_m * noise.normal() / east_m).to_degrees(),
                alt_m + self.alt_sigma_m * noise.normal(),
                truth.velocity_mps[0][row] + self.velocity_sigma_mps * noise.normal(),
                truth.velocity_mps[1][row] + self.velocity_sigma_mps * noise.normal(),
                truth.velocity_mps[2][row] + self.velocity_sigma_mps * noise.normal(),
            ];
            columns.iter_mut().zip(values).for_each(|(column, value)| column[row] = value);
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::{fs, path::Path};

    use tempfile::TempDir;

    use super::*;
    use crate::spec::SynthSpec;

    /// A line of 200 s at 10 Hz.
    const FLIGHT: &str = "seed = 3\n[map]\npath = 'none.tif'\n[[flights]]\nname = 'A'\n[[flights.lines]]\n\
        name = 'A.1'\nalt_m = 500.0\nduration_s = 200.0\nwaypoints = [[-22.05, 140.6], [-21.9, 140.65]]\n";

    fn spec(gnss: &str) -> SynthSpec {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("s.synth.toml");
        fs::write(&path, format!("{FLIGHT}{gnss}")).unwrap();
        SynthSpec::read(&path).unwrap()
    }

    #[test]
    fn law_a_receiver_has_the_noise_and_the_interval_of_its_keys() {
        assert_eq!(spec("").gnss, None);
        let spec = spec("[gnss]\nsigma_m = 3.0\nvelocity_sigma_mps = 0.2\ninterval_s = 0.5");
        let flight = &spec.flights[0];
        let scene = SynthLineContext { path: Path::new("s"), spec: &spec, flight, line: &flight.lines[0] };
        let truth = scene.fly();
        let columns = spec.gnss.as_ref().unwrap().along(&scene, &truth);
        let fixes: Vec<usize> = (0..truth.tt_s.len()).filter(|row| columns[0][*row].is_finite()).collect();
        assert!(fixes.iter().enumerate().all(|(number, row)| *row == 5 * number), "{fixes:?}");
        assert!(columns.iter().all(|column| column.iter().filter(|x| x.is_finite()).count() == fixes.len()));
        let scatter = |column: usize, of: &[f64], m: f64| {
            let square = |row: &usize| (m * (columns[column][*row] - of[*row])).powi(2);
            (fixes.iter().map(square).sum::<f64>() / fixes.len() as f64).sqrt()
        };
        // About 400 draws determine a standard deviation to 3.5 % (one sigma).
        let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < 0.12;
        assert!(near(scatter(0, &truth.lat_deg, 110_740.0), 3.0) && near(scatter(1, &truth.lon_deg, 103_300.0), 3.0));
        assert!(near(scatter(2, &truth.alt_m, 1.0), 4.0) && near(scatter(4, &truth.velocity_mps[1], 1.0), 0.2));
    }
}
