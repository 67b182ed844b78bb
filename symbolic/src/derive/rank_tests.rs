//! Dependent sums are found, and no others.

use isophote_elementary::Function1;

use super::*;
use crate::program::{ChannelId, CoordinateId};

#[test]
fn combinations_are_found_with_their_coefficients() {
    let mut graph = Graph::default();
    let x = graph.coordinate(CoordinateId(0));
    let phi = graph.channel(ChannelId(0));
    let t = graph.call1(Function1::Tanh, x);
    let square = graph.product(1.0, [(t, 2)]);
    let slope = graph.sum(1.0, [(square, -1.0)]);
    let mixed = graph.product(1.0, [(t, 1), (phi, 1)]);
    let sum = graph.sum(0.0, [(mixed, 0.3), (t, -2.5)]);
    let found = dependent(&graph, &[t, square, mixed, slope, sum, phi]);
    let expected =
        vec![(slope, vec![(None, 1.0), (Some(square), -1.0)]), (sum, vec![(Some(t), -2.5), (Some(mixed), 0.3)])];
    assert_eq!(found, expected);
    assert!(dependent(&graph, &[t, mixed, phi, x]).is_empty());
}
