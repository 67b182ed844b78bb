//! The random grammar of documents: formulas that print themselves, and documents around them. Independent of the code
//! under test; tests of machine code use it too, so it names only public items of this crate.

use std::fmt;
use std::fmt::Write;

use super::Random;
use isophote_symbolic::{Function1, Function2};

pub const PARAMETERS: usize = 6;

fn pick<T: Copy>(random: &mut Random, all: &[T]) -> T {
    all[random.below(all.len())]
}

fn one_in(random: &mut Random, n: usize) -> bool {
    random.below(n) == 0
}

type Boxed = Box<Tree>;

/// A formula.
#[derive(Clone, Debug)]
pub enum Tree {
    Number(f64),
    Coordinate(usize),
    /// The channel that is not fitted.
    Predictor,
    Parameter(usize),
    Constant,
    Definition(usize),
    /// The model's own prediction, in `noise`.
    Intensity,
    /// The argument of a user function.
    Argument,
    /// The index of a sum or product.
    Index,
    Negative(Boxed),
    Add(Boxed, Boxed),
    Sub(Boxed, Boxed),
    Mul(Boxed, Boxed),
    Div(Boxed, Boxed),
    Whole(Boxed, i32),
    Real(Boxed, f64),
    Sqrt(Boxed),
    Abs(Boxed),
    /// `true`: the maximum.
    Extreme(bool, Boxed, Boxed),
    /// `if` for one condition, `piecewise` for more.
    Choice(Vec<(Condition, Tree)>, Boxed),
    Call1(Function1, Boxed),
    /// `atan2(a, b)` or `a^b`.
    Call2(Function2, Boxed, Boxed),
    /// `true`: a product.
    Series(bool, Boxed, i32, i32),
    /// A call of a user function, by index.
    Own(usize, Boxed),
    Dot(Vec<Tree>, Vec<Tree>),
    /// u′ A u with A symmetric: u₀, u₁, a₁, a₂, a₃.
    Form(Box<[Tree; 5]>),
    Entry(Vec<Tree>, usize),
}

#[derive(Clone, Debug)]
pub enum Condition {
    Compare(&'static str, Tree, Tree),
    And(Box<Condition>, Box<Condition>),
    Or(Box<Condition>, Box<Condition>),
    Not(Box<Condition>),
}

impl Tree {
    fn plus(self, b: Tree) -> Tree {
        Tree::Add(Box::new(self), Box::new(b))
    }
    fn minus(self, b: Tree) -> Tree {
        Tree::Sub(Box::new(self), Box::new(b))
    }
    fn times(self, b: Tree) -> Tree {
        Tree::Mul(Box::new(self), Box::new(b))
    }
    fn squared(self) -> Tree {
        Tree::Whole(Box::new(self), 2)
    }
}

fn list(trees: &[Tree]) -> String {
    trees.iter().map(|tree| tree.to_string()).collect::<Vec<_>>().join(", ")
}

impl fmt::Display for Tree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Tree::Number(x) if *x < 0.0 => write!(f, "({x})"),
            Tree::Number(x) => write!(f, "{x}"),
            Tree::Coordinate(i) => write!(f, "{}", ["x", "y"][*i]),
            Tree::Predictor => write!(f, "u"),
            Tree::Parameter(i) => write!(f, "p{i}"),
            Tree::Constant => write!(f, "k"),
            Tree::Definition(i) => write!(f, "d{i}"),
            Tree::Intensity => write!(f, "intensity"),
            Tree::Argument => write!(f, "t"),
            Tree::Index => write!(f, "i"),
            Tree::Negative(a) => write!(f, "(-{a})"),
            Tree::Add(a, b) => write!(f, "({a} + {b})"),
            Tree::Sub(a, b) => write!(f, "({a} - {b})"),
            Tree::Mul(a, b) => write!(f, "{a} * {b}"),
            Tree::Div(a, b) => write!(f, "({a} / ({b}))"),
            Tree::Whole(a, n) => write!(f, "({a})^{n}"),
            Tree::Real(a, c) => write!(f, "({a})^{c}"),
            Tree::Sqrt(a) => write!(f, "sqrt({a})"),
            Tree::Abs(a) => write!(f, "abs({a})"),
            Tree::Extreme(max, a, b) => write!(f, "{}({a}, {b})", if *max { "max" } else { "min" }),
            Tree::Choice(pairs, otherwise) => {
                write!(f, "{}(", if pairs.len() == 1 { "if" } else { "piecewise" })?;
                for (condition, value) in pairs {
                    write!(f, "{condition}, {value}, ")?;
                }
                write!(f, "{otherwise})")
            }
            Tree::Call1(function, a) => write!(f, "{}({a})", function.name()),
            Tree::Call2(Function2::Atan2, a, b) => write!(f, "atan2({a}, {b})"),
            Tree::Call2(Function2::Pow, a, b) => write!(f, "({a})^({b})"),
            Tree::Series(product, a, lo, hi) => {
                write!(f, "{}({a}, i, {lo}, {hi})", if *product { "product" } else { "sum" })
            }
            Tree::Own(g, a) => write!(f, "g{g}({a})"),
            Tree::Dot(a, b) => write!(f, "([{}]' * [{}])", list(a), list(b)),
            Tree::Form(parts) => {
                let [u, v, a, b, c] = &**parts;
                write!(f, "([{u}, {v}]' * [[{a}, {b}], [{b}, {c}]] * [{u}, {v}])")
            }
            Tree::Entry(all, i) => write!(f, "[{}][{i}]", list(all)),
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Condition::Compare(sign, a, b) => write!(f, "{a} {sign} {b}"),
            Condition::And(a, b) => write!(f, "({a} and {b})"),
            Condition::Or(a, b) => write!(f, "({a} or {b})"),
            Condition::Not(a) => write!(f, "(not ({a}))"),
        }
    }
}

/// The names that a formula may use.
#[derive(Clone, Copy)]
pub struct Scope {
    pub coordinates: usize,
    pub parameters: usize,
    pub definitions: usize,
    pub functions: usize,
    pub predictor: bool,
    /// Inside a user function.
    pub argument: bool,
    /// Inside a sum.
    pub index: bool,
}

impl Scope {
    fn leaf(&self, random: &mut Random) -> Tree {
        match random.below(16) {
            0..=3 => Tree::Coordinate(random.below(self.coordinates)),
            4 | 5 if self.argument => Tree::Argument,
            6 | 7 if self.index => Tree::Index,
            4 if self.predictor => Tree::Predictor,
            5 | 6 if self.definitions > 0 => Tree::Definition(random.below(self.definitions)),
            7 => Tree::Constant,
            8 | 9 => Tree::Number((random.between(-3.0, 6.0) * 100.0).round() / 100.0),
            _ => Tree::Parameter(random.below(self.parameters)),
        }
    }

    /// Positive for any leaves: 0.3 + e², or e^…
    fn positive(&self, random: &mut Random, depth: usize) -> Tree {
        let inner = Box::new(self.tree(random, depth));
        match random.below(3) {
            0 => Tree::Call1(Function1::Exp, Box::new(Tree::Mul(Box::new(Tree::Number(-0.25)), inner))),
            _ => Tree::Add(Box::new(Tree::Number(0.3)), Box::new(Tree::Whole(inner, 2))),
        }
    }

    pub fn condition(&self, random: &mut Random, depth: usize) -> Condition {
        let sign = pick(random, &["<", "<=", ">", ">=", "<", "<=", ">", ">=", "==", "!="]);
        let compare = Condition::Compare(sign, self.tree(random, depth), self.tree(random, depth));
        match random.below(6) {
            0 => Condition::And(Box::new(compare), Box::new(self.condition(random, depth))),
            1 => Condition::Or(Box::new(compare), Box::new(self.condition(random, depth))),
            2 => Condition::Not(Box::new(compare)),
            _ => compare,
        }
    }

    /// A formula of about that depth at most.
    pub fn tree(&self, random: &mut Random, depth: usize) -> Tree {
        if depth == 0 || one_in(random, 7) {
            return self.leaf(random);
        }
        let depth = depth - 1;
        let many = |random: &mut Random, n: usize| (0..n).map(|_| self.tree(random, depth.min(1))).collect::<Vec<_>>();
        let branch = |random: &mut Random| (self.condition(random, depth.min(1)), self.tree(random, depth));
        let kind = random.below(36);
        let mut sub = || Box::new(self.tree(random, depth));
        match kind {
            0..=3 => Tree::Add(sub(), sub()),
            4..=7 => Tree::Sub(sub(), sub()),
            8..=12 => Tree::Mul(sub(), sub()),
            13 => Tree::Div(sub(), sub()),
            14 => Tree::Div(sub(), Box::new(self.positive(random, depth))),
            15 | 16 => Tree::Whole(sub(), pick(random, &[2, 2, 2, 3, 4, -1, -2])),
            17 => Tree::Real(Box::new(self.positive(random, depth)), pick(random, &[0.5, 1.5, -0.5, 2.3, -1.7])),
            18 => Tree::Call2(Function2::Pow, Box::new(self.positive(random, depth)), Box::new(self.leaf(random))),
            19 => Tree::Sqrt(Box::new(self.positive(random, depth))),
            20 => Tree::Abs(sub()),
            21 => Tree::Extreme(one_in(random, 2), Box::new(self.tree(random, depth)), Box::new(self.leaf(random))),
            22 => Tree::Choice(vec![branch(random)], Box::new(self.tree(random, depth))),
            23 => Tree::Choice(vec![branch(random), branch(random)], Box::new(self.tree(random, depth))),
            24 | 25 => Tree::Call1(pick(random, &Function1::ALL), Box::new(self.tree(random, depth))),
            26 => {
                let small = Box::new(Tree::Mul(Box::new(Tree::Number(0.15)), sub()));
                Tree::Call1(pick(random, &Function1::ALL), small)
            }
            27 => Tree::Call2(Function2::Atan2, sub(), sub()),
            28 if !self.index => {
                let inner = Scope { index: true, ..*self }.tree(random, depth);
                let lo = random.below(3) as i32;
                Tree::Series(one_in(random, 4), Box::new(inner), lo, lo + random.below(3) as i32)
            }
            29 if self.functions > 0 => Tree::Own(random.below(self.functions), Box::new(self.tree(random, depth))),
            30 => Tree::Dot(many(random, 2), many(random, 2)),
            31 => Tree::Form(Box::new(std::array::from_fn(|_| self.tree(random, depth.min(1))))),
            32 => Tree::Entry(many(random, 3), random.below(3)),
            33 => Tree::Negative(sub()),
            34 | 35 if self.definitions > 0 => self.spelled(random),
            _ => self.leaf(random),
        }
    }

    /// A model-like formula: a height times a shape on a background, or one thing less another; or anything.
    fn intensity(&self, random: &mut Random, depth: usize) -> Tree {
        match random.below(6) {
            0 | 1 => {
                let height = Tree::Parameter(random.below(self.parameters)).times(self.tree(random, depth));
                Tree::Parameter(random.below(self.parameters)).plus(height)
            }
            2 | 3 if self.definitions > 0 => {
                let spelled = self.spelled(random);
                spelled.plus(self.tree(random, depth.min(2)))
            }
            _ => self.tree(random, depth),
        }
    }
}

impl Scope {
    /// A formula as people write them with names: a difference of one thing and a share of it, shared minuends, nested
    /// pieces. Needs at least one of `self.definitions`.
    fn spelled(&self, random: &mut Random) -> Tree {
        let leaf = |random: &mut Random| match random.below(3) {
            0 => Tree::Definition(random.below(self.definitions)),
            1 => Tree::Parameter(random.below(self.parameters)),
            _ => self.leaf(random),
        };
        let q = Tree::Definition(random.below(self.definitions));
        let (t, w) = (leaf(random), leaf(random));
        match random.below(9) {
            0 => q.clone().minus(t.times(q)),
            1 => q.clone().minus(q.times(t)),
            2 => t.clone().times(q.clone()).minus(q).plus(w),
            3 => q.clone().minus(t).times(q.minus(w)),
            4 => t.clone().minus(q.clone().times(t)).plus(w.times(q)),
            5 => Tree::Negative(Box::new(q.clone().minus(t.times(w)))).plus(q),
            6 => q.clone().minus(t.clone().times(q.clone())).minus(w.clone().times(q)),
            7 => {
                let pieces = Tree::Choice(vec![(self.condition(random, 1), q.clone())], Box::new(t));
                Tree::Choice(vec![(self.condition(random, 1), pieces)], Box::new(q.minus(w)))
            }
            _ => {
                let condition = self.condition(random, 0);
                let inner = Tree::Choice(vec![(condition.clone(), q.clone())], Box::new(w.clone()));
                Tree::Choice(vec![(condition, inner.minus(t))], Box::new(w.times(q)))
            }
        }
    }

    /// A formula of exponentials of unbounded arguments that has a bounded size or slope: a smooth ramp, a smooth
    /// modulus, a step, the larger of two lines.
    fn growing(&self, random: &mut Random) -> Tree {
        let mut line = || {
            let at = |random: &mut Random| Tree::Number(20.0).times(Tree::Parameter(random.below(self.parameters)));
            let offset = Tree::Coordinate(random.below(self.coordinates)).minus(at(random));
            let width = pick(random, &[0.6, 2.5, 5.2, 20.0, 61.0, -2.5, -20.0]);
            let line = Tree::Div(Box::new(offset), Box::new(Tree::Number(width)));
            let is_tilted = one_in(random, 3);
            let tilt =
                Tree::Div(Box::new(Tree::Coordinate(random.below(self.coordinates))), Box::new(Tree::Number(3.0)));
            if is_tilted { line.plus(tilt) } else { line }
        };
        let (first, second) = (line(), line());
        let of = |function: Function1, tree: Tree| Tree::Call1(function, Box::new(tree));
        let exp = of(Function1::Exp, first.clone());
        let above = Tree::Number(1.0).plus(exp.clone());
        let over = |a: Tree, b: Tree| Tree::Div(Box::new(a), Box::new(b));
        match random.below(8) {
            0 | 1 => of(Function1::Log, above),
            2 => of(Function1::Log, of(Function1::Cosh, first)),
            3 => over(Tree::Number(1.0), above),
            4 => over(exp, above),
            5 => of(Function1::Log, exp.plus(of(Function1::Exp, second))),
            6 => over(of(Function1::Sinh, first.clone()), of(Function1::Cosh, first)),
            _ => over(exp.clone(), exp.plus(of(Function1::Exp, second))),
        }
    }

    /// A row value that is NaN in some rows.
    fn chord(&self, random: &mut Random) -> Tree {
        let offset = Tree::Coordinate(self.coordinates - 1).minus(Tree::Parameter(random.below(self.parameters)));
        match random.below(4) {
            0 => Tree::Call1(Function1::Log, Box::new(offset)),
            _ => Tree::Sqrt(Box::new(Tree::Number(random.between(2.0, 40.0).round() + 0.5).minus(offset.squared()))),
        }
    }

    /// A disc, or a point on a line.
    fn disc(&self, random: &mut Random) -> Condition {
        let offset = |random: &mut Random, coordinate: usize| {
            Tree::Coordinate(coordinate).minus(Tree::Parameter(random.below(self.parameters))).squared()
        };
        let mut square = offset(random, 0);
        if self.coordinates > 1 {
            square = square.plus(offset(random, 1));
        }
        Condition::Compare(pick(random, &["<", "<="]), square, Tree::Number(random.between(2.0, 40.0).round() + 0.5))
    }

    /// The domain of a document; some rows have no pixel.
    fn domain(&self, random: &mut Random, positive: &[bool]) -> Condition {
        let p = |i: usize| Tree::Parameter(i % self.parameters);
        let first = positive[..self.parameters].iter().position(|&p| p);
        let boxed = |a: Condition, b: Condition| (Box::new(a), Box::new(b));
        match (random.below(10), first) {
            // A quadratic inequality: bounds of a row.
            (0..=2, Some(a)) => {
                let offset = Tree::Coordinate(0).minus(p(random.below(6)));
                let y = Tree::Coordinate(self.coordinates - 1);
                let form = Tree::Form(Box::new([offset, y, p(a), Tree::Number(0.1), p(a)]));
                Condition::Compare("<=", form, Tree::Number(random.between(5.0, 80.0).round() + 0.5))
            }
            (0..=4, _) => self.disc(random),
            (5, _) => {
                let (a, b) = boxed(self.disc(random), self.disc(random));
                Condition::Or(a, b)
            }
            (6, _) => {
                let half = Condition::Compare(">=", Tree::Coordinate(0), p(random.below(6)));
                let (a, b) = boxed(half, self.disc(random));
                Condition::And(a, b)
            }
            (7, _) => {
                let (a, b) = boxed(self.disc(random), self.condition(random, 1));
                let (both, other) = boxed(Condition::And(a, b), self.disc(random));
                Condition::Or(both, other)
            }
            _ => self.condition(random, 2),
        }
    }
}

/// The features that a document may use.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Variety {
    /// Least squares over one channel, sampled at the pixel's centre.
    Plain,
    /// The same with exponentials, for pictures that are thousands of pixels wide.
    Wide,
    /// Robust losses, pixels at their limit, several channels, mixtures of them, Gauss points.
    Any,
}

/// A random document.
pub struct Document {
    pub scope: Scope,
    pub functions: Vec<Tree>,
    pub definitions: Vec<Tree>,
    pub observed: &'static str,
    /// One per entry of `observed`.
    pub intensities: Vec<Tree>,
    pub noise: Option<Tree>,
    pub domain: Option<Condition>,
    /// Further lines of `[model]`.
    pub further: Vec<&'static str>,
    /// Parameters declared positive.
    pub positive: [bool; PARAMETERS],
}

impl Document {
    pub fn new(random: &mut Random, variety: Variety) -> Document {
        let parameters = 1 + random.below(PARAMETERS);
        let coordinates = 1 + usize::from(!one_in(random, 3));
        let (functions, definitions) = (random.below(3), random.below(5));
        let predictor = one_in(random, 4);
        let bare =
            Scope { coordinates, parameters, definitions: 0, functions: 0, predictor, argument: false, index: false };
        let depth = pick(random, &[1, 2, 3, 3, 4, 4, 5]);
        let functions: Vec<Tree> = (0..functions).map(|_| Scope { argument: true, ..bare }.tree(random, 2)).collect();
        let with = Scope { functions: functions.len(), ..bare };
        let is_chord = one_in(random, 5);
        let definition = |i: usize| match i {
            0 if is_chord => with.chord(random),
            0 => with.tree(random, depth.min(3)),
            _ if one_in(random, 2) => Scope { definitions: i, ..with }.spelled(random),
            _ => Scope { definitions: i, ..with }.tree(random, depth.min(3)),
        };
        let definitions: Vec<Tree> = (0..definitions).map(definition).collect();
        let scope = Scope { definitions: definitions.len(), ..with };
        let noise = one_in(random, 5).then(|| {
            let base = if one_in(random, 2) { Tree::Intensity } else { scope.tree(random, 2) };
            match random.below(2) {
                0 => Tree::Number(0.5).plus(base.squared()),
                _ => {
                    let above = Tree::Extreme(true, Box::new(base), Box::new(Tree::Number(0.0)));
                    Tree::Number(0.7).plus(Tree::Constant.times(above))
                }
            }
        });
        let positive = std::array::from_fn(|_| one_in(random, 3));
        let reading = if predictor { bare } else { scope };
        let is_cut = one_in(random, if is_chord { 1 } else { 3 });
        let domain = is_cut.then(|| Scope { predictor: false, ..reading }.domain(random, &positive));
        let (mut observed, mut further) = ("phi", Vec::new());
        if variety == Variety::Any {
            if !predictor {
                observed = pick(random, &["phi", "phi", "phi - 0.25 * u", "max(phi, u)", "[phi, u]"]);
            }
            for lines in [
                &["loss = \"huber(1.5)\"", "loss = \"tukey(4)\"", "", "", ""][..],
                &["saturated = \"censored\"", "saturated = \"predicted\"", "", "", ""],
                &["quadrature = 2", "", "", "", "", "", "", ""],
            ] {
                further.push(pick(random, lines));
            }
        }
        let entries = if observed.starts_with('[') { 2 } else { 1 };
        let mut intensities: Vec<Tree> = (0..entries).map(|_| scope.intensity(random, depth)).collect();
        if entries > 1 && !one_in(random, 3) {
            // The same light in the other channel, scaled.
            let share = Tree::Constant.times(intensities[0].clone());
            intensities[1] = Tree::Parameter(random.below(parameters)).plus(share);
        }
        if variety == Variety::Wide {
            let parameter = |random: &mut Random| Tree::Parameter(random.below(parameters));
            let height = parameter(random).times(scope.growing(random));
            intensities = vec![parameter(random).plus(if one_in(random, 3) {
                height.times(scope.growing(random))
            } else {
                height
            })];
        }
        let domain = domain.filter(|_| variety != Variety::Wide);
        Document { scope, functions, definitions, observed, intensities, noise, domain, further, positive }
    }

    pub fn text(&self) -> String {
        let mut text = String::from("name = \"random\"\n");
        let mut line = |line: String| writeln!(text, "{line}").unwrap();
        line(format!("coordinates = {}", ["[\"x\"]", "[\"x\", \"y\"]"][self.scope.coordinates - 1]));
        line("channels = [\"phi\", \"u\"]\n[parameters]".into());
        for i in 0..self.scope.parameters {
            let bound = if self.positive[i] { ", min = 0.0" } else { "" };
            line(format!("p{i} = {{ start = 1.0{bound} }}"));
        }
        line("[constants]\nk = 0.4\n[definitions]".into());
        self.functions.iter().enumerate().for_each(|(i, g)| line(format!("\"g{i}(t)\" = \"{g}\"")));
        self.definitions.iter().enumerate().for_each(|(i, d)| line(format!("d{i} = \"{d}\"")));
        line(format!("[model]\nobserved = \"{}\"", self.observed));
        match &self.intensities[..] {
            [one] => line(format!("intensity = \"{one}\"")),
            many => line(format!("intensity = \"[{}]\"", list(many))),
        }
        self.noise.iter().for_each(|noise| line(format!("noise = \"{noise}\"")));
        self.domain.iter().for_each(|domain| line(format!("domain = \"{domain}\"")));
        self.further.iter().filter(|further| !further.is_empty()).for_each(|further| line(further.to_string()));
        text
    }
}
