//! The loop bodies of the thesis' Table 6.1: gradient and Hessian in separate loops or jointly in one, with the
//! derivatives as written ("plain") or optimised.

use isophote_symbolic::{Lowering, Method, Model, ParameterId, Part};
use isophote_tracker::{plain_flops, plain_program};

/// Flops per pixel, accumulation included and F excluded, in the four columns of the thesis' Table 6.1. Plain counts
/// cover the whole loop body; optimised counts, as everywhere else, only the code left in it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BodyFlops {
    /// Separate loops for gradient and Hessian, plain.
    pub separate_plain: u32,
    /// Separate loops for gradient and Hessian, each optimised on its own.
    pub separate_optimised: u32,
    /// One loop, plain.
    pub joint_plain: u32,
    /// The same without loop invariants per pass or row: what loop-invariant code motion would leave.
    pub joint_plain_hoisted: u32,
    /// One loop, optimised: what is compiled.
    pub joint_optimised: u32,
}

/// Flops per pixel in the four columns of the thesis' Table 6.1; `None` if the derivatives exceed a limit.
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
