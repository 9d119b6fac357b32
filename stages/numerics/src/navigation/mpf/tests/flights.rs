//! Flights over the Osborne map.

use super::*;

pub(super) struct Flight {
    ins: Line,
    measured_nt: Vec<f64>,
    sigma_nt: Vec<f64>,
    errors: Vec<StateVector>,
    model: InsErrorModel,
}

fn osborne() -> &'static (FieldMap, Arc<CoreField>) {
    static MAP: OnceLock<(FieldMap, Arc<CoreField>)> = OnceLock::new();
    MAP.get_or_init(|| {
        (FieldMap::Flat(MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic)), Arc::new(core_field().unwrap()))
    })
}

impl Flight {
    /// One flight with its realisation of the INS errors, the temporal variation and the measurement noise.
    pub(super) fn new(seed: u64, samples: u32, dt_s: f64, position_m: f64) -> Self {
        let (map, core) = osborne();
        let model =
            InsErrorModel::from_sources(InsErrors { init_position_sigma_m: position_m, ..InsErrors::default() });
        let truth = Line::flown(samples, dt_s, 0.1 * seed as f64).unwrap();
        let mut normals = NormalGenerator::new(seed);
        let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
        let mut measured_nt = vec![];
        for (row, error) in errors.iter().enumerate() {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            let field_nt = map.at(lat, lon, alt).unwrap().value_nt + core.magnitude_nt(lat, lon, alt);
            measured_nt.push(field_nt + temporal_nt(error) + 5.0 * normals.draw());
        }
        let (ins, sigma_nt) = (truth.with_errors(&errors), vec![5.0; errors.len()]);
        Self { ins, measured_nt, sigma_nt, errors, model }
    }

    /// The flight as input of a filter.
    pub(super) fn with<T>(&self, of: impl FnOnce(&NavigationLine<'_>) -> T) -> T {
        let (map, core) = osborne();
        let (ins, Self { measured_nt, sigma_nt, model, .. }) = (self.ins.series(), self);
        of(&NavigationLine {
            ins: &ins,
            measurement_nt: measured_nt,
            sigma_nt,
            map,
            core: Some(core),
            errors: *model,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        })
    }

    fn mpf(&self, parameters: MpfParameters) -> MpfOutput {
        self.with(|line| run(&MpfParameters { keep_states: true, ..parameters }, line, &Aids::default()).unwrap())
    }

    pub(super) fn ekf(&self) -> NavigationOutput {
        let (map, core) = osborne();
        let parameters = EkfParameters { errors: self.model, ..EkfParameters::default() };
        ekf::run(&parameters, &self.ins.series(), &self.measured_nt, map, Some(core)).unwrap()
    }

    /// Square of the horizontal error at a row, in m², and the NEES of the horizontal position.
    pub(super) fn error(&self, track: &NavigationOutput, row: usize) -> (f64, f64) {
        let (north, east) = EARTH.north_east_m_per_rad(track.lat_deg[row].to_radians(), 500.0);
        let n = north * (self.errors[row][LAT] - track.x[row][LAT]);
        let e = east * (self.errors[row][LON] - track.x[row][LON]);
        let (a, b, c) = (track.sd_n_m[row].powi(2), track.cov_ne_m2[row], track.sd_e_m[row].powi(2));
        (n * n + e * e, (c * n * n - 2.0 * b * n * e + a * e * e) / (a * c - b * b))
    }
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normal deviates, by the formula of Wilson and
/// Hilferty.
fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

#[test]
fn law_on_nominal_flights_it_is_consistent_and_equals_the_kalman_filter() {
    const FLIGHTS: u64 = 30;
    const ROWS: [usize; 5] = [150, 450, 750, 1050, 1199];
    let n = FLIGHTS as f64;
    let mut nees = [0.0; ROWS.len()];
    let (mut ours, mut ekf_mean, mut nis, mut resamplings) = (0.0, 0.0, 0.0, 0);
    for seed in 0..FLIGHTS {
        let flight = Flight::new(seed, 1200, 1.0, 3.0);
        let (out, ekf) = (flight.mpf(MpfParameters { seed, ..MpfParameters::default() }), flight.ekf());
        for (nees, row) in nees.iter_mut().zip(ROWS) {
            *nees += flight.error(&out.track, row).1 / n;
        }
        let square = |track: &NavigationOutput| (0..1200).map(|row| flight.error(track, row).0).sum::<f64>() / 1200.0;
        ours += square(&out.track) / n;
        ekf_mean += square(&ekf) / n;
        nis += out.track.nis.iter().sum::<f64>() / (1200.0 * n);
        resamplings += out.report.resamplings;
        assert_eq!((out.report.unexplained, out.report.collapsed, out.track.report.updates), (0, 0, 1200));
    }
    let (ours, ekf_mean) = (ours.sqrt(), ekf_mean.sqrt());
    let (low, high) = (chi_square(2.0 * n, -1.96) / n, chi_square(2.0 * n, 1.96) / n);
    println!("NEES {nees:.2?}, band {low:.2}..{high:.2}; NIS {nis:.3}; {resamplings} resamplings");
    println!("DRMS {ours:.1} m, Kalman filter {ekf_mean:.1} m");
    // By chance, one epoch in twenty is outside the band.
    assert!(nees.iter().filter(|nees| !(low..=high).contains(nees)).count() <= 1, "{nees:?}");
    let mean = nees.iter().sum::<f64>() / ROWS.len() as f64;
    let all = 2.0 * n * ROWS.len() as f64;
    // All epochs together: the 99.9 % band, because neighbouring epochs are correlated.
    assert!((chi_square(all, -3.29)..=chi_square(all, 3.29)).contains(&(mean * n * ROWS.len() as f64)), "{mean}");
    assert!((nis - 1.0).abs() < 0.05 && ours < 1.1 * ekf_mean, "{nis} {ours} {ekf_mean}");
}

#[test]
fn law_an_ins_lost_by_kilometres_is_recovered_where_the_kalman_filter_fails() {
    const FLIGHTS: u64 = 10;
    let (mut found, mut by_ekf, mut unaware) = (0, 0, 0);
    for seed in 0..FLIGHTS {
        let flight = Flight::new(seed, 300, 3.0, 3000.0);
        let out = flight.mpf(MpfParameters { particles: 6000, seed, ..MpfParameters::default() });
        let error_m = |track: &NavigationOutput| flight.error(track, 299).0.sqrt();
        found += usize::from(error_m(&out.track) < 60.0);
        by_ekf += usize::from(error_m(&flight.ekf()) < 60.0);
        let report = out.track.report;
        let told = out.report.unexplained > 0
            || report.off_map > 30
            || out.track.sd_n_m[299].hypot(out.track.sd_e_m[299]) > 200.0;
        unaware += usize::from(error_m(&out.track) >= 60.0 && !told);
    }
    println!("of {FLIGHTS} found: {found}, by the Kalman filter {by_ekf}; lost without a flag: {unaware}");
    assert!(found >= 5 && by_ekf <= 3 && unaware == 0, "{found} {by_ekf} {unaware}");
}

/// Prints the time per step in µs; run it by name, in an optimised build.
#[test]
#[ignore = "a measurement of time"]
fn unit_time_of_a_step() {
    let flight = Flight::new(1, 3600, 1.0, 3.0);
    for particles in [500, 1000, 2000, 20_000] {
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let start = std::time::Instant::now();
            let out = flight.mpf(MpfParameters { particles, ..MpfParameters::default() });
            best = best.min(start.elapsed().as_secs_f64() * 1e6 / out.usage.len() as f64);
        }
        println!("{particles} particles: {best:.0} microseconds a step");
    }
}
