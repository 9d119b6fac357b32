//! Navigation of a line: true, INS and estimated track, with the filter's covariance of the estimation error.

use figures::ellipse::Ellipse;
use numerics::{earth::geodesy::EarthModel, regression::statistics::position_nees};
use plan::{LineId, TableRef};
use schemas::{Fault, Role};

use super::{source::ReportSource, subject::ReportSubject};

/// Track: latitudes and longitudes in degrees.
#[derive(Clone, Debug, PartialEq)]
pub struct DegreeTrack {
    /// Latitudes.
    pub lat: Vec<f64>,
    /// Longitudes.
    pub lon: Vec<f64>,
}

/// Offsets north and east, in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackOffsets {
    /// North.
    pub north: Vec<f64>,
    /// East.
    pub east: Vec<f64>,
}

/// Tracks and filter outputs of one line.
pub struct LineTracks {
    /// Times, in seconds.
    pub tt: Vec<f64>,
    /// The true track, if known.
    pub truth: Option<DegreeTrack>,
    /// The track of the INS alone.
    pub ins: Option<DegreeTrack>,
    /// The estimate.
    pub estimate: DegreeTrack,
    /// Standard deviations north and east, in metres, and the covariance of both errors, in m².
    pub sigma: Option<[Vec<f64>; 3]>,
    /// Innovations, in nT.
    pub residual: Option<Vec<f64>>,
    /// Squared innovations divided by their predicted variances.
    pub nis: Option<Vec<f64>>,
}

impl DegreeTrack {
    fn read(source: &ReportSource, r: TableRef, line: LineId, names: [&str; 2]) -> Result<Option<DegreeTrack>, Fault> {
        let (lat, lon) = (source.floats(r, line, names[0])?, source.floats(r, line, names[1])?);
        Ok(lat.zip(lon).map(|(lat, lon)| DegreeTrack { lat, lon }))
    }

    /// Positions of the track, as latitude and longitude.
    pub fn places(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.lat.iter().copied().zip(self.lon.iter().copied())
    }

    /// The position at a row.
    pub fn at(&self, k: usize) -> Option<(f64, f64)> {
        let place = (*self.lat.get(k)?, *self.lon.get(k)?);
        (place.0.is_finite() && place.1.is_finite()).then_some(place)
    }

    /// Offsets of the track from `other`.
    pub fn less(&self, other: &DegreeTrack) -> TrackOffsets {
        let offset = |(own, other)| EarthModel::default().offset_ne_m(other, own, 0.0);
        let (north, east) = self.places().zip(other.places()).map(offset).unzip();
        TrackOffsets { north, east }
    }
}

impl LineTracks {
    /// Navigation of `line` in `subject`; `None` if the line has no navigation.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn read(source: &ReportSource, subject: &ReportSubject, line: LineId) -> Result<Option<LineTracks>, Fault> {
        let Some(r @ TableRef::Stage(t, i)) = subject.navigate else { return Ok(None) };
        let Some(flights) = source.graph.plan.instance(t, i).first_input() else { return Ok(None) };
        let column = |name: &str| source.floats(r, line, name);
        let estimate = DegreeTrack::read(source, r, line, ["lat", "lon"])?;
        let (Some(tt), Some(estimate)) = (column("tt")?, estimate) else { return Ok(None) };
        let is_truth = source.shape(flights).is_some_and(|s| s.get("lat").is_some_and(|c| c.role == Role::Truth));
        let truth = if is_truth { DegreeTrack::read(source, flights, line, ["lat", "lon"])? } else { None };
        let ins = DegreeTrack::read(source, flights, line, ["ins_lat", "ins_lon"])?;
        let sigma = match (column("sd_n")?, column("sd_e")?, column("cov_ne")?) {
            (Some(n), Some(e), Some(ne)) => Some([n, e, ne]),
            _ => None,
        };
        Ok(Some(LineTracks { tt, truth, ins, estimate, sigma, residual: column("residual")?, nis: column("nis")? }))
    }

    /// The estimate's errors, truth minus estimate.
    pub fn errors(&self) -> Option<TrackOffsets> {
        self.truth.as_ref().map(|truth| truth.less(&self.estimate))
    }

    /// The errors of the INS alone, truth minus INS, as in the states of the filter.
    pub fn ins_errors(&self) -> Option<TrackOffsets> {
        Some(self.truth.as_ref()?.less(self.ins.as_ref()?))
    }

    /// Error ellipse of the estimate at row `k`, at `sigmas` standard deviations.
    pub fn ellipse(&self, k: usize, sigmas: f64) -> Option<Ellipse> {
        let [sd_n, sd_e, cov_ne] = self.sigma.as_ref()?;
        Ellipse::new(*sd_n.get(k)?, *sd_e.get(k)?, *cov_ne.get(k)?, sigmas)
    }
}

/// Squared position errors in units of their covariance, e' P⁻¹ e.
pub fn nees(errors: &TrackOffsets, [sd_n, sd_e, cov]: &[Vec<f64>; 3]) -> Vec<f64> {
    position_nees(&errors.north, &errors.east, sd_n, sd_e, cov)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_nees_of_one_sigma_each_way_is_two() {
        let errors = TrackOffsets { north: vec![3.0, 3.0], east: vec![-4.0, -4.0] };
        let values = nees(&errors, &[vec![3.0; 2], vec![4.0; 2], vec![0.0, -6.0]]);
        assert!((values[0] - 2.0).abs() < 1e-12);
        // A correlation of -0.5 reduces the NEES of the same error to 2 (1 - 0.5) / (1 - 0.25).
        assert!((values[1] - 4.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn unit_north_is_positive_northwards() {
        let (truth, own) = (
            DegreeTrack { lat: vec![-22.0], lon: vec![140.0] },
            DegreeTrack { lat: vec![-21.999], lon: vec![139.999] },
        );
        let offsets = own.less(&truth);
        assert!(
            (110.0..111.5).contains(&offsets.north[0]) && (-104.0..-102.0).contains(&offsets.east[0]),
            "{offsets:?}"
        );
    }
}
