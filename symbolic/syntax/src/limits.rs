//! Bounds on a document, checked before work is spent.

/// Bounds on a model document and on what is derived from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of a document.
    pub document_bytes: usize,
    /// Bytes of a document besides numbers and the blanks, commas and brackets around them.
    pub text_bytes: usize,
    /// Tokens of all formulas of a document.
    pub tokens: usize,
    /// Nesting of a formula, and of calls of the user's functions.
    pub depth: usize,
    /// Definitions of a document.
    pub definitions: usize,
    /// Bytes of a name.
    pub name_bytes: usize,
    /// Parameters of a document.
    pub parameters: usize,
    /// Combinations of the starts of all parameters.
    pub starts: usize,
    /// Constants of a document.
    pub constants: usize,
    /// Coordinates of a document.
    pub coordinates: usize,
    /// Raw planes of a document.
    pub channels: usize,
    /// Tables of a document.
    pub tables: usize,
    /// Samples of all tables of a document.
    pub samples: usize,
    /// Stages of a document.
    pub stages: usize,
    /// Gauss points per side of a pixel.
    pub gauss_points: usize,
    /// Iterations of a stage.
    pub iterations: u32,
    /// Terms of one `sum` or `product`.
    pub terms: usize,
    /// Arguments of a user function.
    pub arguments: usize,
    /// Entries of a matrix.
    pub entries: usize,
    /// Magnitude of an integer exponent.
    pub exponent: i64,
    /// Nodes of the expression graph, counted while it grows.
    pub nodes: usize,
    /// Units of work to read a document and derive all its stages; a unit takes 50 to 100 ns of one processor.
    pub work: usize,
    /// Operations kept by its programs and their formulas, all stages together.
    pub kept: usize,
    /// Operations of the equivalence check of all programs of a document against its formulas.
    pub proof: usize,
    /// Instructions of a pixel loop; the whole program has at most [`Limits::nodes`].
    pub instructions: usize,
    /// Diagnostics reported per document.
    pub diagnostics: usize,
}

/// The bounds in force.
pub const LIMITS: Limits = Limits {
    document_bytes: 1024 * 1024,
    text_bytes: 64 * 1024,
    tokens: 8192,
    depth: 64,
    definitions: 128,
    name_bytes: 64,
    parameters: 64,
    starts: 16,
    constants: 64,
    coordinates: 4,
    channels: 8,
    tables: 16,
    samples: 65_536,
    stages: 8,
    gauss_points: 5,
    iterations: 1000,
    terms: 1024,
    arguments: 16,
    entries: 256,
    exponent: 64,
    nodes: 32_768,
    work: 4_000_000,
    kept: 262_144,
    proof: 40_000_000,
    instructions: 8192,
    diagnostics: 64,
};
