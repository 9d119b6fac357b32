//! The trees of an interrupted training as bytes.

use super::{RegressionTree, RegressionTreeNode};

/// The first bytes of stored trees; the last byte is the version of the layout.
const HEAD: [u8; 8] = *b"MAGTREE\x01";
/// First number of a node: its kind.
const LEAF: u64 = 0;
const SPLIT: u64 = 1;

/// Trees as bytes: a head, the number of nodes and the nodes of each tree, all as little-endian numbers of eight bytes,
/// and a checksum (FNV-1a).
pub fn trees_to_bytes(trees: &[RegressionTree]) -> Vec<u8> {
    let mut out = HEAD.to_vec();
    let mut put = |number: u64| out.extend(number.to_le_bytes());
    for tree in trees {
        put(tree.nodes.len() as u64);
        for node in &tree.nodes {
            match *node {
                RegressionTreeNode::Leaf { value } => [LEAF, value.to_bits()].into_iter().for_each(&mut put),
                RegressionTreeNode::Split { feature, threshold, left, right } => {
                    let numbers = [SPLIT, feature as u64, threshold.to_bits(), left as u64, right as u64];
                    numbers.into_iter().for_each(&mut put);
                }
            }
        }
    }
    let sum = checksum(&out);
    out.extend(sum.to_le_bytes());
    out
}

/// Reads trees from bytes; `None` for bytes that are not trees, truncated or altered.
pub fn trees_from_bytes(bytes: &[u8]) -> Option<Vec<RegressionTree>> {
    let (whole, sum) = bytes.split_last_chunk::<8>()?;
    if checksum(whole) != u64::from_le_bytes(*sum) {
        return None;
    }
    let (numbers, rest) = whole.strip_prefix(&HEAD)?.as_chunks::<8>();
    let mut numbers = numbers.iter().map(|number| u64::from_le_bytes(*number));
    let mut trees = vec![];
    while let Some(count) = numbers.next() {
        let mut nodes = vec![];
        for _ in 0..count {
            nodes.push(node(&mut numbers)?);
        }
        trees.push(RegressionTree { nodes });
    }
    rest.is_empty().then_some(trees)
}

fn node(numbers: &mut impl Iterator<Item = u64>) -> Option<RegressionTreeNode> {
    let kind = numbers.next()?;
    let place = |number: Option<u64>| usize::try_from(number?).ok();
    if kind == LEAF {
        return Some(RegressionTreeNode::Leaf { value: f64::from_bits(numbers.next()?) });
    }
    if kind != SPLIT {
        return None;
    }
    let feature = place(numbers.next())?;
    let threshold = f64::from_bits(numbers.next()?);
    let left = place(numbers.next())?;
    Some(RegressionTreeNode::Split { feature, threshold, left, right: place(numbers.next())? })
}

/// 64-bit FNV-1a hash.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_trees_read_back_and_altered_bytes_are_rejected() {
        let split = RegressionTreeNode::Split { feature: 3, threshold: -0.1, left: 1, right: 2 };
        let leaf = |value| RegressionTreeNode::Leaf { value };
        let trees = vec![
            RegressionTree { nodes: vec![split, leaf(0.5), leaf(-1e-300)] },
            RegressionTree { nodes: vec![leaf(f64::MIN_POSITIVE)] },
        ];
        let bytes = trees_to_bytes(&trees);
        assert_eq!(trees_from_bytes(&bytes), Some(trees));
        assert_eq!(trees_from_bytes(&trees_to_bytes(&[])), Some(vec![]));
        for at in 0..bytes.len() {
            assert_eq!(trees_from_bytes(&bytes[..at]), None);
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert_eq!(trees_from_bytes(&flipped), None, "byte {at}");
        }
    }
}
