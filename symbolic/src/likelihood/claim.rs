//! The claim of what a program sums, shared by derivation and check.

/// The derivatives that a loop sums.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Part {
    /// The gradient.
    Gradient,
    /// The upper triangle of the Hessian.
    Hessian,
    /// Both, in one loop.
    Both,
    /// The gradient and the Hessian's diagonal.
    Diagonal,
}

impl Part {
    /// True when it contains the gradient.
    pub fn has_gradient(self) -> bool {
        self != Part::Hessian
    }
    /// True when it contains some of the Hessian.
    pub fn has_hessian(self) -> bool {
        self != Part::Gradient
    }
    /// True when it contains that entry of the Hessian's upper triangle.
    pub fn has_entry(self, row: usize, column: usize) -> bool {
        match self {
            Part::Gradient => false,
            Part::Hessian | Part::Both => true,
            Part::Diagonal => row == column,
        }
    }
}

/// The sums of a value objective.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum ValueKind {
    /// Σ r²/σ², σ² held at the entry parameters, to compare the steps of a pass. One output, F.
    Entry,
    /// Σ r²/σ² + ln σ² at the parameters themselves, for the report. Two outputs: F, and Σ r²/σ².
    Full,
}

/// The claimed sums of a program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Claim {
    /// F, and the gradient, the upper Hessian, or both.
    Derivatives { newton: bool, part: Part },
    /// F, gradient and Gauss–Newton's Hessian of a pass entered at the parameters themselves.
    Opening,
    /// F, gradient and the Hessian's diagonal by Gauss–Newton, then the two outputs of [`ValueKind::Full`].
    Closing,
    /// F alone.
    Value(ValueKind),
}

impl Claim {
    /// True for derivatives of F itself to second order, those of its variance included.
    pub fn is_newton(self) -> bool {
        matches!(self, Claim::Derivatives { newton: true, .. })
    }

    /// The derivatives among the sums.
    pub fn part(self) -> Option<Part> {
        match self {
            Claim::Derivatives { part, .. } => Some(part),
            Claim::Opening => Some(Part::Both),
            Claim::Closing => Some(Part::Diagonal),
            Claim::Value(_) => None,
        }
    }

    /// True when weights and pixel set belong to the parameters themselves.
    pub fn is_at_entry(self) -> bool {
        self == Claim::Opening
    }
}
