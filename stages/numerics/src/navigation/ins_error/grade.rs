//! Grades of inertial navigation systems with published parameters.

use params::choice;

use super::{InsErrorModel, InsErrors};

choice! {
    /// Grade of an INS.
    #[derive(Default)]
    pub enum InsGrade {
        /// The defaults of MagNav.jl: a navigation-grade INS after a good alignment.
        #[default]
        Magnav = "magnav",
        /// Honeywell HG9900. [Lee 2019, Tables 9 and 10]
        Navigation = "navigation",
        /// Honeywell HG1700. [Lee 2019, Tables 9 and 10]
        Tactical = "tactical",
        /// Micro-mechanical sensors. [Lee 2019, Tables 9 and 10]
        ///
        /// The gyroscopes of this grade drift by half a degree per second, so the position error exceeds a thousand
        /// kilometres within a quarter of an hour. Such an INS is usable for one or two minutes.
        Commercial = "commercial",
    }
}

impl InsGrade {
    /// All grades.
    pub const ALL: [Self; 4] = [Self::Magnav, Self::Navigation, Self::Tactical, Self::Commercial];

    /// Error model of an INS of this grade.
    pub fn model(self) -> InsErrorModel {
        InsErrorModel::from_sources(self.errors())
    }

    /// Error sources of an INS of this grade.
    ///
    /// The tables give velocity and angular random walk, and the standard deviations of the biases (time constant 3600
    /// s). The numbers of the accelerometer and gyroscope biases are also used for the initial velocity (m/s) and tilt
    /// (rad). The initial position is exact, and the initial height has a standard deviation of 5 m. Angular random
    /// walk and gyroscope bias are in rad/√s and rad/s, despite the printed units. The tables do not specify the
    /// barometer; all grades use the barometer of MagNav.jl.
    pub fn errors(self) -> InsErrors {
        match self {
            Self::Magnav => InsErrors::default(),
            Self::Navigation => of_table_9([1e-12, 2.4525e-4, 5.8178e-7, 1.4544e-8]),
            Self::Tactical => of_table_9([0.003_302, 9.81e-3, 3.6361e-5, 4.8481e-6]),
            Self::Commercial => of_table_9([0.0043, 0.1960, 6.5e-4, 0.0087]),
        }
    }
}

/// Velocity random walk, accelerometer bias, angular random walk, gyroscope bias.
fn of_table_9([vrw_sigma, acc_sigma_mps2, arw_sigma, gyro_sigma_radps]: [f64; 4]) -> InsErrors {
    InsErrors {
        init_position_sigma_m: 0.0,
        init_altitude_sigma_m: 5.0,
        init_velocity_sigma_mps: acc_sigma_mps2,
        init_attitude_sigma_deg: gyro_sigma_radps.to_degrees(),
        vrw_sigma,
        arw_sigma,
        acc_sigma_mps2,
        gyro_sigma_radps,
        acc_tau_s: 3600.0,
        gyro_tau_s: 3600.0,
        ..InsErrors::default()
    }
}
