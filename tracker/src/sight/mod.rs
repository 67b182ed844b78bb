//! Analyses a frame before any model is fitted: background, components, colours, the clipping level and starting values of
//! parameters.
//!
//! Uses neither a kernel's derivatives nor earlier frames.

pub(crate) mod background;
pub(crate) mod clipping;
pub(crate) mod cold;
pub(crate) mod colours;
pub(crate) mod component;
pub(crate) mod contour;
pub(crate) mod defective;
pub(crate) mod detect;
pub(crate) mod elsewhere;
pub(crate) mod gaps;
pub(crate) mod grey;
pub(crate) mod halved;
pub(crate) mod mask;
pub(crate) mod mixing;
pub(crate) mod radial;
pub(crate) mod response;
pub(crate) mod start;
pub(crate) mod transfer;
pub(crate) mod view;
pub(crate) mod wave;
