//! The order in which the nodes of a structured mesh are eliminated: nested dissection (George
//! 1973). A plane of nodes cuts the mesh in two halves that do not touch, and comes after both. It
//! keeps the factor of a mesh in space sparse where a band would fill.

/// Boxes of at most so many nodes are not cut.
const SMALLEST: usize = 12;

/// Nodes along the axes, first to last in the order of elimination. `step` is the order of the
/// elements: only planes between elements cut.
pub(super) fn order<const D: usize>(counts: [usize; D], step: usize) -> Vec<[usize; D]> {
    let mut out = Vec::with_capacity(counts.iter().product());
    cut([0; D], counts, step, &mut out);
    out
}

fn cut<const D: usize>(low: [usize; D], high: [usize; D], step: usize, out: &mut Vec<[usize; D]>) {
    let span: [usize; D] = core::array::from_fn(|axis| high[axis] - low[axis]);
    let longest = (0..D).max_by_key(|axis| span[*axis]).unwrap_or(0);
    let middle = (low[longest] + span[longest] / 2).next_multiple_of(step);
    let small = span.iter().product::<usize>() <= SMALLEST;
    if small || middle <= low[longest] || middle + 1 >= high[longest] {
        return all(low, high, out);
    }
    let (mut left, mut right) = (high, low);
    left[longest] = middle;
    right[longest] = middle + 1;
    cut(low, left, step, out);
    cut(right, high, step, out);
    let (mut from, mut to) = (low, high);
    (from[longest], to[longest]) = (middle, middle + 1);
    all(from, to, out);
}

/// Every node of a box.
fn all<const D: usize>(low: [usize; D], high: [usize; D], out: &mut Vec<[usize; D]>) {
    if (0..D).any(|axis| low[axis] >= high[axis]) {
        return;
    }
    let mut at = low;
    loop {
        out.push(at);
        let mut axis = D;
        loop {
            if axis == 0 {
                return;
            }
            axis -= 1;
            at[axis] += 1;
            if at[axis] < high[axis] {
                break;
            }
            at[axis] = low[axis];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::order;

    #[test]
    fn every_node_comes_once_and_halves_do_not_touch() {
        for (counts, step) in [([9, 7, 5], 1), ([9, 13, 5], 2), ([2, 2, 2], 1), ([31, 3, 9], 2)] {
            let nodes = order(counts, step);
            let mut seen = nodes.clone();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), counts.iter().product::<usize>());
            assert_eq!(nodes.len(), seen.len());
        }
        let nodes = order([17, 3, 3], 1);
        assert!(nodes[nodes.len() - 9..].iter().all(|at| at[0] == 8), "the first cut comes last");
    }
}
