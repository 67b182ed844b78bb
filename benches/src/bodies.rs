//! The loop bodies that the thesis' Table 6.1 compares: gradient and Hessian each in a loop of its own or jointly in one,
//! as the derivatives were written down ("plain") or optimised.

use isophote_symbolic::{Lowering, Method, Model, ParameterId, Part};
use isophote_tracker::{plain_flops, plain_program};

/// Flops per pixel, accumulation included and F left out, in the four columns of the thesis' Table 6.1. Plain counts are
/// those of the whole loop body; optimised counts are those of what is left in it, as everywhere else.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BodyFlops {
    /// A loop for the gradient and one for the Hessian, plain.
    pub separate_plain: u32,
    /// A loop for the gradient and one for the Hessian, each optimised for itself.
    pub separate_optimised: u32,
    /// One loop, plain.
    pub joint_plain: u32,
    /// The same without what is known per pass or row: what a compiler that moves code out of loops would leave in it.
    pub joint_plain_hoisted: u32,
    /// One loop, optimised: what is compiled.
    pub joint_optimised: u32,
}

/// Flops per pixel in the four columns of the thesis' Table 6.1; `None` where the derivatives grow past a limit.
pub fn body_flops(model: &Model, subset: &[ParameterId], method: Method) -> Option<BodyFlops> {
    let lowering = Lowering { fma: true, drop_saturated: false };
    let plain = |part| plain_program(model, subset, method, part);
    let optimised = |part| Some(model.part_objective(subset, method, part).ok()?.cost(lowering).ok()?.flops_per_pixel);
    let joint = plain(Part::Both)?;
    Some(BodyFlops {
        separate_plain: plain_flops(&plain(Part::Gradient)?) + plain_flops(&plain(Part::Hessian)?),
        separate_optimised: optimised(Part::Gradient)? + optimised(Part::Hessian)?,
        joint_plain: plain_flops(&joint),
        joint_plain_hoisted: joint.cost().flops_per_pixel,
        joint_optimised: model.objective(subset, method).ok()?.cost(lowering).ok()?.flops_per_pixel,
    })
}
