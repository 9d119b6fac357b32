//! Training with candle's tensors and its AdamW optimiser. Without weight decay, AdamW is Adam.

use candle_core::{DType, Device, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW, loss};

use crate::{BATCH, Each, Failure, HIDDEN, INPUTS, ROWS, Work};

/// Trains and returns the weights, hidden layer first.
pub fn train(work: &Work, double: bool, each: Each) -> Result<Vec<f64>, Failure> {
    let device = Device::Cpu;
    let dtype = if double { DType::F64 } else { DType::F32 };
    let tensor = |values: &[f64], shape: &[usize]| Tensor::from_slice(values, shape, &device)?.to_dtype(dtype);
    let x = tensor(&work.x, &[ROWS, INPUTS])?;
    let y = tensor(&work.y, &[ROWS, 1])?;
    let w1 = Var::from_tensor(&tensor(&work.hidden, &[INPUTS, HIDDEN])?)?;
    let b1 = Var::zeros(HIDDEN, dtype, &device)?;
    let w2 = Var::from_tensor(&tensor(&work.output, &[HIDDEN, 1])?)?;
    let b2 = Var::zeros(1, dtype, &device)?;
    let vars = vec![w1.clone(), b1.clone(), w2.clone(), b2.clone()];
    let mut adam = AdamW::new(vars.clone(), ParamsAdamW { weight_decay: 0.0, ..ParamsAdamW::default() })?;
    for order in &work.orders {
        let mut sum = 0.0;
        for batch in order.chunks(BATCH) {
            let at = Tensor::from_slice(batch, batch.len(), &device)?;
            let (x, y) = (x.index_select(&at, 0)?, y.index_select(&at, 0)?);
            let hidden = x.matmul(&w1)?.broadcast_add(&b1)?.silu()?;
            let found = hidden.matmul(&w2)?.broadcast_add(&b2)?;
            let loss = loss::mse(&found, &y)?;
            adam.backward_step(&loss)?;
            sum += loss.to_dtype(DType::F64)?.to_scalar::<f64>()? * batch.len() as f64;
        }
        each(sum / ROWS as f64);
    }
    let mut weights = vec![];
    for var in &vars {
        weights.extend(var.as_tensor().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?);
    }
    Ok(weights)
}
