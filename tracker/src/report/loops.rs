//! The thesis' Table 6.1 for any model: the cost per pixel of plain and of compiled derivatives; gradient and Hessian
//! in loops of their own, or jointly.

use isophote_frame::{Frame, Plane};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, VectorWidth, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, ParameterId, Part, Precision, Program};
use serde::{Deserialize, Serialize};

use super::bodies::{over_pixels_of, plain_flops, plain_program};
use super::points::{ModelPoint, Numbers, sizes};
use crate::track::window::Reach;

/// Cost of a loop per pixel, in two formulations. Figures are absent for programs beyond a size limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct LoopCost {
    /// Quantities that the loop sums.
    #[cfg_attr(feature = "schema", schema(inline))]
    pub sums: LoopSums,
    /// Derivatives as differentiation yields them: common subexpressions computed once, nothing hoisted out of the loop.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub differentiated: Option<BodyCost>,
    /// The compiled loop.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub compiled: Option<BodyCost>,
}

/// Quantities that a loop sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum LoopSums {
    /// The gradient.
    Gradient,
    /// The upper triangle of the Hessian.
    Hessian,
    /// Both, in one loop.
    Joint,
}

/// Cost of one loop body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BodyCost {
    /// Flops per pixel, including accumulation, without F itself.
    pub flops_per_pixel: u32,
    /// Time per pixel on one core, ns, for 8-bit pixels in f32 with 128-bit vectors: the shortest of several passes around a
    /// synthetic target. Absent if it cannot be measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ns_per_pixel: Option<f64>,
}

/// Passes per measurement; the shortest counts.
const PASSES: usize = 9;

/// Gradient, Hessian and both of a subset of the parameters. `clock_ns`: any monotonic clock.
pub fn loop_costs(model: &Model, subset: &[ParameterId], method: Method, clock_ns: &dyn Fn() -> u64) -> Vec<LoopCost> {
    let bench = Bench::of(model);
    let lowering = Lowering { fma: has_fma(), drop_saturated: false };
    let both = |(sums, part)| {
        let plain = plain_program(model, subset, method, part);
        let objective = match part {
            Part::Both => model.objective(subset, method),
            _ => model.part_objective(subset, method, part),
        };
        // The objective's count excludes F, which its loop also sums.
        let compiled = objective.ok().and_then(|objective| {
            Some((objective.program(lowering).ok()?, objective.cost(lowering).ok()?.flops_per_pixel))
        });
        let ns = |program: &Program| bench.as_ref()?.ns_per_pixel(program, clock_ns);
        let differentiated = plain.map(|program| {
            let same_pixels = compiled.as_ref().and_then(|(compiled, _)| over_pixels_of(&program, compiled));
            BodyCost { flops_per_pixel: plain_flops(&program), ns_per_pixel: same_pixels.as_ref().and_then(ns) }
        });
        let compiled =
            compiled.map(|(program, flops_per_pixel)| BodyCost { flops_per_pixel, ns_per_pixel: ns(&program) });
        LoopCost { sums, differentiated, compiled }
    };
    let all = [(LoopSums::Gradient, Part::Gradient), (LoopSums::Hessian, Part::Hessian), (LoopSums::Joint, Part::Both)];
    all.into_iter().map(both).collect()
}

/// A synthetic target in a uniform image.
struct Bench {
    parameters: Vec<f64>,
    constants: Vec<f64>,
    frame: Frame,
    window: Window,
}

/// Value of all pixels.
const GREY: u8 = 100;

impl Bench {
    fn of(model: &Model) -> Option<Bench> {
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        let reach = Reach::of(model, &constants);
        let at = |size: &f64| ModelPoint::made_up(model, &constants, &reach, *size, Numbers::AsStarted);
        let ModelPoint { parameters, window } = sizes(model).iter().find_map(at)?;
        let Window { x, y, width, height, slices } = window;
        let sides = [x + width, y + height, slices.first[0] + slices.count[0], slices.first[1] + slices.count[1]];
        let plane = || Plane::owned(PixelFormat::U8, vec![GREY; sides.iter().product()], sides[0]);
        let frame = Frame::new(&sides, model.channels().iter().map(|_| plane()).collect()).ok()?;
        Some(Bench { parameters, constants, frame, window })
    }

    fn ns_per_pixel(&self, program: &Program, clock_ns: &dyn Fn() -> u64) -> Option<f64> {
        let formats = vec![PixelFormat::U8; self.frame.planes().len()];
        let packed = formats.len() == 1;
        let options = KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, packed, formats };
        let kernel = Kernel::compile(program, &options).ok()?;
        let planes: Vec<_> = (0..self.frame.planes().len()).map(|plane| self.frame.plane_view(plane)).collect();
        let limits = vec![f64::INFINITY; planes.len()];
        let (parameters, constants) = (&self.parameters[..], &self.constants[..]);
        let bindings = Bindings { parameters, entry: parameters, constants, saturation: &limits, shift: &[] };
        let pass = || {
            let begin_ns = clock_ns();
            let sums = kernel.sums(&bindings, &planes, self.window).ok()?;
            Some((clock_ns().saturating_sub(begin_ns), sums.pixels))
        };
        let passes: Option<Vec<(u64, u64)>> = (0..PASSES).map(|_| pass()).collect();
        let (ns, pixels) = passes?.into_iter().min()?;
        (pixels > 0).then(|| ns as f64 / pixels as f64)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::cell::Cell;

    use super::*;

    #[test]
    fn loop_costs_reproduce_the_thesis_table() {
        let model = Model::from_toml(include_str!("../../../models/thesis-spot.toml")).unwrap();
        let subset: Vec<ParameterId> = ["bx", "by"].iter().map(|name| model.parameter(name).unwrap()).collect();
        let ticks = Cell::new(0);
        let clock_ns = || ticks.replace(ticks.get() + 1_000_000);
        let costs = loop_costs(&model, &subset, Method::Newton, &clock_ns);
        let flops = |of: fn(&LoopCost) -> Option<BodyCost>| -> Vec<u32> {
            costs.iter().map(|cost| of(cost).unwrap().flops_per_pixel).collect()
        };
        let (plain, compiled) = (flops(|cost| cost.differentiated), flops(|cost| cost.compiled));
        assert!(plain.iter().zip(&compiled).all(|(plain, compiled)| plain > compiled), "{plain:?} {compiled:?}");
        for [gradient, hessian, joint] in [plain, compiled].map(|all| <[u32; 3]>::try_from(all).unwrap()) {
            assert!(joint < gradient + hessian && joint > gradient.max(hessian));
        }
        // Both loops see the same pixels.
        let ns = |cost: &LoopCost| [cost.differentiated, cost.compiled].map(|body| body.unwrap().ns_per_pixel.unwrap());
        assert!(costs.iter().all(|cost| ns(cost)[0] == ns(cost)[1] && ns(cost)[0] > 0.0), "{costs:?}");
    }
}
