//! Spill counts.

use super::*;
use crate::{Lowering, Method, Model, ParameterId};

#[test]
fn fewer_registers_spill_more() {
    let text = include_str!("../../../models/thesis-spot.toml");
    let model = Model::from_toml(text).unwrap();
    let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    let lowering = Lowering { fma: true, drop_saturated: false };
    let program = model.objective(&all, Method::Newton).unwrap().program(lowering).unwrap();
    let counts = [4, 6, OF_16, OF_32, 64].map(|registers| spills(&program, registers));
    assert!(counts.is_sorted_by(|a, b| a >= b), "{counts:?}");
    assert!(counts[0] > 0 && counts[4] == 0, "{counts:?}");
    let pair = model.objective(&all[..2], Method::Newton).unwrap().program(lowering).unwrap();
    assert_eq!(spills(&pair, OF_16), 0);
}
