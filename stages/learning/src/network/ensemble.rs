//! Ensembles of networks: the mean and spread of their predictions.

/// Joint prediction of the members of an ensemble. [Lakshminarayanan, Pritzel & Blundell 2017]
#[derive(Debug, Clone, PartialEq)]
pub struct EnsemblePrediction {
    /// Mean of the members' predictions for each row, in the unit of the predictions.
    pub mean: Vec<f64>,
    /// Standard deviation (n − 1) of the members' predictions for each row. The spread measures the effect of another
    /// seed, or of training without a line. The spread excludes the noise of the target and errors that all members
    /// share.
    pub deviation: Vec<f64>,
}

impl EnsemblePrediction {
    /// The joint prediction of two or more members for the same rows. `None` for fewer members or unequal numbers of
    /// rows.
    pub fn from_members(members: &[Vec<f64>]) -> Option<Self> {
        let rows = members.first()?.len();
        if members.len() < 2 || members.iter().any(|member| member.len() != rows) {
            return None;
        }
        let count = members.len() as f64;
        let mut mean = vec![0.0; rows];
        for member in members {
            mean.iter_mut().zip(member).for_each(|(sum, x)| *sum += x);
        }
        mean.iter_mut().for_each(|sum| *sum /= count);
        let mut deviation = vec![0.0; rows];
        for member in members {
            let off = member.iter().zip(&mean).map(|(x, mean)| x - mean);
            deviation.iter_mut().zip(off).for_each(|(sum, off)| *sum += off * off);
        }
        deviation.iter_mut().for_each(|sum| *sum = (*sum / (count - 1.0)).sqrt());
        Some(Self { mean, deviation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_mean_and_deviation_agree_with_a_manual_calculation() {
        let found = EnsemblePrediction::from_members(&[vec![1.0, -2.0], vec![2.0, -2.0], vec![6.0, -2.0]]).unwrap();
        assert_eq!((found.mean, found.deviation), (vec![3.0, -2.0], vec![7.0f64.sqrt(), 0.0]));
        assert_eq!(EnsemblePrediction::from_members(&[vec![1.0]]), None);
        assert_eq!(EnsemblePrediction::from_members(&[]), None);
        assert_eq!(EnsemblePrediction::from_members(&[vec![1.0], vec![]]), None);
        assert!(EnsemblePrediction::from_members(&[vec![1.0], vec![f64::NAN]]).unwrap().deviation[0].is_nan());
    }
}
