//! The order in which the nodes of a structured mesh are eliminated: nested dissection (George
//! 1973). A plane of nodes cuts the mesh in two halves that do not touch, and comes after both. In
//! space it keeps the factor sparse, where a band would fill with entries.

/// Most nodes of a box that is not cut further.
const UNCUT_NODES_MAX: usize = 12;

/// Nodes along the axes, first to last in the order of elimination. `step` is the order of the
/// elements: only planes between elements cut.
pub(super) fn elimination_order<const D: usize>(
    counts: [usize; D],
    step: usize,
) -> Vec<[usize; D]> {
    let mut out = Vec::with_capacity(counts.iter().product());
    dissect([0; D], counts, step, &mut |_, [from, to]| append_nodes(from, to, &mut out));
    out
}

/// Upper bound of the entries of a factor in this order: a part is coupled to itself and to the
/// nodes around the box that it cuts.
pub(super) fn factor_entries_max<const D: usize>(counts: [usize; D], step: usize) -> f64 {
    let mut sum = 0.0;
    let volume = |[low, high]: NodeBox<D>| -> f64 {
        low.iter().zip(high).map(|(low, high)| (high - low) as f64).product()
    };
    dissect([0; D], counts, step, &mut |[low, high], part| {
        let wide_low = low.map(|at| at.saturating_sub(1));
        let wide_high = core::array::from_fn(|axis| (high[axis] + 1).min(counts[axis]));
        let around = D as f64 * (volume([wide_low, wide_high]) - volume([low, high]));
        let own = D as f64 * volume(part);
        sum += own * (0.5 * (own + 1.0) + around);
    });
    sum
}

/// First nodes along the axes, and those after the last ones.
type NodeBox<const D: usize> = [[usize; D]; 2];

/// Visits the parts in the order of elimination, each with the box that it cuts (or fills).
fn dissect<const D: usize>(
    low: [usize; D],
    high: [usize; D],
    step: usize,
    visit: &mut impl FnMut(NodeBox<D>, NodeBox<D>),
) {
    let span: [usize; D] = core::array::from_fn(|axis| high[axis] - low[axis]);
    let longest = (0..D).max_by_key(|axis| span[*axis]).unwrap_or(0);
    let middle = (low[longest] + span[longest] / 2).next_multiple_of(step);
    let small = span.iter().product::<usize>() <= UNCUT_NODES_MAX;
    if small || middle <= low[longest] || middle + 1 >= high[longest] {
        return visit([low, high], [low, high]);
    }
    let (mut left, mut right) = (high, low);
    left[longest] = middle;
    right[longest] = middle + 1;
    dissect(low, left, step, visit);
    dissect(right, high, step, visit);
    let (mut from, mut to) = (low, high);
    (from[longest], to[longest]) = (middle, middle + 1);
    visit([low, high], [from, to]);
}

/// Appends every node of a box.
fn append_nodes<const D: usize>(low: [usize; D], high: [usize; D], out: &mut Vec<[usize; D]>) {
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
    use super::{elimination_order, factor_entries_max};
    use crate::fem::{Elements, Kind, Mesh, graded_edges};
    use crate::layer::Layer;

    #[test]
    fn every_node_comes_once_and_halves_do_not_touch() {
        for (counts, step) in [([9, 7, 5], 1), ([9, 13, 5], 2), ([2, 2, 2], 1), ([31, 3, 9], 2)] {
            let nodes = elimination_order(counts, step);
            let mut seen = nodes.clone();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), counts.iter().product::<usize>());
            assert_eq!(nodes.len(), seen.len());
        }
        let nodes = elimination_order([17, 3, 3], 1);
        assert!(
            nodes[nodes.len() - 9..].iter().all(|at| at[0] == 8),
            "the first dissect comes last"
        );
    }

    #[test]
    fn a_factor_keeps_no_more_than_was_foreseen() {
        for (n, nz, order) in [(6, 2, 1), (12, 3, 1), (4, 1, 2), (6, 2, 2)] {
            let edges = graded_edges(3.0, n, 0.0).expect("edges");
            let heights = graded_edges(0.8, nz, 0.0).expect("edges");
            let mesh = Mesh::block(&edges, &edges, &heights, order).expect("a mesh");
            let most = factor_entries_max(mesh.counts(), order);
            let layer = Layer::new(0.8, 27.58, 0.49).expect("a layer");
            let body = Elements::new(&layer, mesh, Kind::MeanDilatation).expect("elements");
            let kept = body.factor_entries() as f64;
            assert!(kept <= most && most < 8.0 * kept, "{n} {nz} {order}: {kept} of {most}");
        }
    }
}
