//! What a program claims to sum: the words that derivation and check share.

/// Which derivatives a loop sums.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Part {
    /// The gradient.
    Gradient,
    /// The upper triangle of the Hessian.
    Hessian,
    /// Both, in one loop.
    Both,
}

impl Part {
    /// The gradient is part of it.
    pub fn has_gradient(self) -> bool {
        self != Part::Hessian
    }
    /// The Hessian is part of it.
    pub fn has_hessian(self) -> bool {
        self != Part::Gradient
    }
}

/// What a value objective sums.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum ValueKind {
    /// Σ r²/σ², σ² held at the entry parameters: what a pass' steps are compared by. One output, F.
    Entry,
    /// Σ r²/σ² + ln σ² at the parameters themselves, for the report. Two outputs: F, and Σ r²/σ².
    Full,
}

/// What a program claims to sum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Claim {
    /// F, and the gradient, the upper Hessian, or both.
    Derivatives { newton: bool, part: Part },
    /// F alone.
    Value(ValueKind),
}
