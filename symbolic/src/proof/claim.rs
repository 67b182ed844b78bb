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
    /// The gradient, and of the Hessian the diagonal.
    Diagonal,
}

impl Part {
    /// The gradient is part of it.
    pub fn has_gradient(self) -> bool {
        self != Part::Hessian
    }
    /// Of the Hessian all or some is part of it.
    pub fn has_hessian(self) -> bool {
        self != Part::Gradient
    }
    /// That entry of the Hessian's upper triangle is part of it.
    pub fn has_entry(self, row: usize, column: usize) -> bool {
        match self {
            Part::Gradient => false,
            Part::Hessian | Part::Both => true,
            Part::Diagonal => row == column,
        }
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
    /// F, gradient and Gauss–Newton's Hessian of a pass that is entered at the parameters themselves.
    Opening,
    /// F, gradient and the Hessian's diagonal as Gauss–Newton has them, then the two outputs of [`ValueKind::Full`].
    Closing,
    /// F alone.
    Value(ValueKind),
}

impl Claim {
    /// Derivatives are the second ones of F itself, of its variance as well.
    pub fn is_newton(self) -> bool {
        matches!(self, Claim::Derivatives { newton: true, .. })
    }

    /// Which derivatives are among the sums.
    pub fn part(self) -> Option<Part> {
        match self {
            Claim::Derivatives { part, .. } => Some(part),
            Claim::Opening => Some(Part::Both),
            Claim::Closing => Some(Part::Diagonal),
            Claim::Value(_) => None,
        }
    }

    /// Weights and pixel set are those of the parameters themselves.
    pub fn is_at_entry(self) -> bool {
        self == Claim::Opening
    }
}
