//! State of a training at the end of an epoch.

use super::lbfgs::LbfgsState;
use super::shape::NetworkShape;
use super::training::TrainingEpoch;

/// The first bytes of a stored state; the last byte is the version of the layout.
const HEAD: [u8; 8] = *b"MAGNET\0\x01";

/// State of a training at the end of an epoch, from which it resumes. With the same samples and settings, the results
/// of a resumed run are bit-identical to those of an uninterrupted run. Random numbers depend on seed, epoch and batch
/// only, so the state holds no generator.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// Number of completed epochs.
    pub epoch: usize,
    /// Current parameters.
    pub parameters: Vec<f64>,
    /// Adam's running means of the gradient.
    pub first_moments: Vec<f64>,
    /// Adam's running means of the squared gradient.
    pub second_moments: Vec<f64>,
    /// `beta_1` and `beta_2` to the power of the number of steps.
    pub powers: [f64; 2],
    /// Factor by which all plateaus so far have reduced the learning rate.
    pub rate_factor: f64,
    /// Number of epochs since the last improvement of the loss or reduction of the rate.
    pub on_plateau: usize,
    /// The parameters with the smallest validation loss; empty without validation.
    pub best: Vec<f64>,
    /// The smallest validation loss; infinite without validation.
    pub best_loss: f64,
    /// The epoch of the smallest validation loss, from 1; 0 without validation.
    pub best_epoch: usize,
    /// State of the L-BFGS method.
    pub lbfgs: LbfgsState,
    /// The Tolles-Lawson coefficients of the physics term, in the scale of the target.
    pub tolles_lawson: Vec<f64>,
    /// The training curve so far.
    pub epochs: Vec<TrainingEpoch>,
}

/// Error of bytes that are not a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TrainingStateError {
    /// The bytes do not begin like a state of this version.
    #[error("these bytes are not a training state of this version; restart the training")]
    NotAState,
    /// Bytes are missing, superfluous or altered.
    #[error("the training state is damaged; restart the training")]
    Damaged,
}

impl TrainingState {
    /// Start of a training from the parameters of [`NetworkShape::initial`] or of a trained model. The physics term
    /// uses the coefficients of the linear terms among these parameters.
    pub fn new(shape: &NetworkShape, parameters: Vec<f64>) -> Self {
        Self::beginning(parameters, shape.linear_start(), shape.linear)
    }

    /// The start from parameters that contain up to `count` linear coefficients, beginning at index `linear`.
    pub(super) fn beginning(parameters: Vec<f64>, linear: usize, count: usize) -> Self {
        let tolles_lawson = parameters.iter().copied().skip(linear).take(count).collect();
        Self {
            epoch: 0,
            first_moments: vec![0.0; parameters.len()],
            second_moments: vec![0.0; parameters.len()],
            powers: [1.0; 2],
            rate_factor: 1.0,
            on_plateau: 0,
            best: vec![],
            best_loss: f64::INFINITY,
            best_epoch: 0,
            lbfgs: LbfgsState::default(),
            tolles_lawson,
            epochs: vec![],
            parameters,
        }
    }

    /// State as bytes: a header, the fields in order as little-endian numbers with a count before each list, and a
    /// checksum (FNV-1a).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = HEAD.to_vec();
        let count = |out: &mut Vec<u8>, n: usize| out.extend((n as u64).to_le_bytes());
        let list = |out: &mut Vec<u8>, x: &[f64]| {
            out.extend((x.len() as u64).to_le_bytes());
            x.iter().for_each(|x| out.extend(x.to_le_bytes()));
        };
        count(&mut out, self.epoch);
        list(&mut out, &self.parameters);
        list(&mut out, &self.first_moments);
        list(&mut out, &self.second_moments);
        list(&mut out, &[self.powers[0], self.powers[1], self.rate_factor, self.best_loss, self.lbfgs.objective]);
        count(&mut out, self.on_plateau);
        list(&mut out, &self.best);
        count(&mut out, self.best_epoch);
        list(&mut out, &self.lbfgs.gradient);
        count(&mut out, self.lbfgs.pairs.len());
        for (moved, change) in &self.lbfgs.pairs {
            list(&mut out, moved);
            list(&mut out, change);
        }
        count(&mut out, usize::from(self.lbfgs.ended));
        list(&mut out, &self.tolles_lawson);
        let curve = |e: &TrainingEpoch| [e.train_loss, e.validation_loss, e.learning_rate];
        list(&mut out, &self.epochs.iter().flat_map(curve).collect::<Vec<f64>>());
        let sum = checksum(&out);
        out.extend(sum.to_le_bytes());
        out
    }

    /// Reads a state from bytes.
    ///
    /// # Errors
    /// Fails for bytes that are not a state, are truncated or are altered.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TrainingStateError> {
        let rest = bytes.strip_prefix(&HEAD).ok_or(TrainingStateError::NotAState)?;
        let (body, sum) = rest.split_last_chunk::<8>().ok_or(TrainingStateError::Damaged)?;
        if checksum(&bytes[..bytes.len() - 8]) != u64::from_le_bytes(*sum) {
            return Err(TrainingStateError::Damaged);
        }
        let mut reader = TrainingStateReader(body);
        let epoch = reader.count()?;
        let (parameters, first_moments, second_moments) = (reader.list()?, reader.list()?, reader.list()?);
        let [beta_1, beta_2, rate_factor, best_loss, objective] =
            reader.list()?.try_into().map_err(|_| TrainingStateError::Damaged)?;
        let (on_plateau, best, best_epoch, gradient) =
            (reader.count()?, reader.list()?, reader.count()?, reader.list()?);
        let mut pairs = vec![];
        for _ in 0..reader.count()? {
            pairs.push((reader.list()?, reader.list()?));
        }
        let ended = reader.count()? != 0;
        let (tolles_lawson, curve) = (reader.list()?, reader.list()?);
        let (curve, left) = curve.as_chunks::<3>();
        if !reader.0.is_empty() || !left.is_empty() {
            return Err(TrainingStateError::Damaged);
        }
        let epoch_of = |[train_loss, validation_loss, learning_rate]: &[f64; 3]| TrainingEpoch {
            train_loss: *train_loss,
            validation_loss: *validation_loss,
            learning_rate: *learning_rate,
        };
        Ok(Self {
            epoch,
            parameters,
            first_moments,
            second_moments,
            powers: [beta_1, beta_2],
            rate_factor,
            on_plateau,
            best,
            best_loss,
            best_epoch,
            lbfgs: LbfgsState { objective, gradient, pairs, ended },
            tolles_lawson,
            epochs: curve.iter().map(epoch_of).collect(),
        })
    }
}

struct TrainingStateReader<'a>(&'a [u8]);

impl TrainingStateReader<'_> {
    fn eight(&mut self) -> Result<[u8; 8], TrainingStateError> {
        let (first, rest) = self.0.split_first_chunk::<8>().ok_or(TrainingStateError::Damaged)?;
        self.0 = rest;
        Ok(*first)
    }

    fn count(&mut self) -> Result<usize, TrainingStateError> {
        usize::try_from(u64::from_le_bytes(self.eight()?)).map_err(|_| TrainingStateError::Damaged)
    }

    fn list(&mut self) -> Result<Vec<f64>, TrainingStateError> {
        let count = self.count()?;
        if count > self.0.len() / 8 {
            return Err(TrainingStateError::Damaged);
        }
        (0..count).map(|_| self.eight().map(f64::from_le_bytes)).collect()
    }
}

/// 64-bit FNV-1a hash.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}
