//! The training with burn's tensors on Flex, its backend in pure Rust, and its Adam.

use burn::{
    module::{Module, Param},
    optim::{AdamConfig, GradientsParams},
    tensor::{DType, Device, Int, Tensor, TensorData, activation::silu},
};

use crate::{BATCH, Each, Failure, HIDDEN, INPUTS, ROWS, Work};

#[derive(Module, Debug)]
struct Network {
    w1: Param<Tensor<2>>,
    b1: Param<Tensor<1>>,
    w2: Param<Tensor<2>>,
    b2: Param<Tensor<1>>,
}

impl Network {
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let hidden = silu(x.matmul(self.w1.val()) + self.b1.val().unsqueeze());
        hidden.matmul(self.w2.val()) + self.b2.val().unsqueeze()
    }
}

/// Trains; the weights, hidden layer first.
pub fn train(work: &Work, double: bool, each: Each) -> Result<Vec<f64>, Failure> {
    let device = Device::flex().autodiff();
    let dtype = if double { DType::F64 } else { DType::F32 };
    let two = |values: &[f64], rows: usize, columns: usize| -> Tensor<2> {
        Tensor::from_data(TensorData::new(values.to_vec(), [rows, columns]), (&device, dtype))
    };
    let one = |values: &[f64]| -> Tensor<1> {
        Tensor::from_data(TensorData::new(values.to_vec(), [values.len()]), (&device, dtype))
    };
    let x = two(&work.x, ROWS, INPUTS);
    let y = two(&work.y, ROWS, 1);
    let mut network = Network {
        w1: Param::from_tensor(two(&work.hidden, INPUTS, HIDDEN)),
        b1: Param::from_tensor(one(&[0.0; HIDDEN])),
        w2: Param::from_tensor(two(&work.output, HIDDEN, 1)),
        b2: Param::from_tensor(one(&[0.0])),
    };
    let mut adam = AdamConfig::new().with_epsilon(1e-8).init();
    for order in &work.orders {
        let mut sum = 0.0;
        for batch in order.chunks(BATCH) {
            let at: Vec<i32> = batch.iter().map(|&i| i as i32).collect();
            let at: Tensor<1, Int> = Tensor::from_data(TensorData::new(at, [batch.len()]), (&device, DType::I32));
            let (x, y) = (x.clone().select(0, at.clone()), y.clone().select(0, at));
            let error = network.forward(x) - y;
            let loss = (error.clone() * error).mean();
            sum += values(loss.clone())?.first().copied().unwrap_or(f64::NAN) * batch.len() as f64;
            let gradients = GradientsParams::from_grads(loss.backward(), &network);
            network = adam.step(1e-3, network, gradients);
        }
        each(sum / ROWS as f64);
    }
    let mut weights = values(network.w1.val().flatten(0, 1))?;
    weights.extend(values(network.b1.val())?);
    weights.extend(values(network.w2.val().flatten(0, 1))?);
    weights.extend(values(network.b2.val())?);
    Ok(weights)
}

fn values(tensor: Tensor<1>) -> Result<Vec<f64>, Failure> {
    let data = tensor.into_data().convert::<f64>();
    data.to_vec::<f64>().map_err(|e| format!("{e:?}").into())
}
