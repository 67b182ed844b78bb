//! Builds the trees that `explain` shows of an [`Objective`] in one of three notations.
//!
//! Order: shared values as definitions; the forms L and Q over cuts; F, its gradient and its upper Hessian, made of
//! sums over the pixels; those sums.

use std::collections::BTreeMap;

use isophote_symbolic::{Expressions, Function2, Input, Names, Node, NodeId, Objective, OutputTerm};

use crate::looks::Looks;
use crate::tree::{Addend, Equation, Expression, Tree, WIDTH};
use crate::{latex, mathml, text};

/// Part of the objective and notation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Show {
    /// Shared values, the forms of F over cuts, and what [`Show::Sums`] shows.
    Derivative,
    /// Outputs as combinations of accumulators, and the accumulators.
    Sums,
    /// As [`Show::Derivative`], for amsmath.
    Latex,
    /// As [`Show::Derivative`], for a web page.
    MathMl,
}

/// Writes a part of the derivation.
pub fn explain(objective: &Objective, show: Show) -> String {
    let forms = if show == Show::Sums { &[][..] } else { objective.forms() };
    let lines = Writer::new(objective, forms).lines(objective, forms);
    match show {
        Show::Derivative | Show::Sums => text::lines(&lines),
        Show::Latex => latex::lines(&lines, &looks(objective.names())),
        Show::MathMl => mathml::lines(&lines, &looks(objective.names())),
    }
}

fn looks(names: &Names) -> Looks {
    Looks::new(&names.coordinates, &spelled(names).collect::<Vec<_>>())
}

fn spelled(names: &Names) -> impl Iterator<Item = &str> {
    [&names.coordinates, &names.channels, &names.parameters, &names.constants].into_iter().flatten().map(String::as_str)
}

/// `letter`, repeated until no name of the document equals it, with trailing digits or without.
fn word(letter: char, names: &Names) -> String {
    let mut word = letter.to_string();
    while spelled(names).any(|name| name.trim_end_matches(|c: char| c.is_ascii_digit()) == word) {
        word.push(letter);
    }
    word
}

/// Turns nodes into trees; a number that is used more than once, and anything too wide, gets a line of its own.
struct Writer<'a> {
    expressions: Expressions<'a>,
    names: &'a Names,
    trees: BTreeMap<NodeId, Tree>,
    lines: Vec<Equation>,
}

impl<'a> Writer<'a> {
    fn new(objective: &'a Objective, forms: &[(String, NodeId)]) -> Writer<'a> {
        let (expressions, names) = (objective.expressions(), objective.names());
        let terms = objective.outputs().iter().flat_map(|o| &o.terms);
        let mut roots: Vec<NodeId> = terms.flat_map(|t| [Some(t.coefficient), t.row, t.pixel]).flatten().collect();
        roots.extend(forms.iter().map(|(_, node)| *node));
        let counts = expressions.use_counts(&roots);
        let shared = word('t', names);
        let mut writer = Writer { expressions, names, trees: BTreeMap::new(), lines: Vec::new() };
        for id in expressions.reachable(&roots) {
            let tree = writer.tree(id);
            let node = expressions.node(id);
            let is_leaf = matches!(node, Node::Number(_) | Node::Input(_) | Node::Coordinate(_) | Node::Channel(_));
            let is_used_again = counts[id.index()] > 1 && !expressions.is_truth(id);
            let tree = if !is_leaf && (is_used_again || text::tree(&tree).len() > WIDTH) {
                let name = Tree::name(format!("{shared}{}", writer.lines.len()));
                writer.lines.push(Equation { left: name.clone(), right: tree });
                name
            } else {
                tree
            };
            writer.trees.insert(id, tree);
        }
        writer
    }

    fn at(&self, id: NodeId) -> Tree {
        self.trees.get(&id).cloned().unwrap_or_else(|| Tree::name("?"))
    }

    fn lines(mut self, objective: &Objective, forms: &[(String, NodeId)]) -> Vec<Equation> {
        let mut numbers: BTreeMap<&str, (usize, String)> = BTreeMap::new();
        let mut times: BTreeMap<&str, usize> = BTreeMap::new();
        forms.iter().for_each(|(name, _)| *times.entry(name).or_default() += 1);
        for (name, node) in forms {
            let letter = name.chars().next().unwrap_or('L');
            let (number, word) = numbers.entry(name).or_insert_with(|| (0, word(letter, self.names)));
            let left = if times[name.as_str()] > 1 { format!("{word}{number}") } else { word.clone() };
            *number += 1;
            let right = self.at(*node);
            self.lines.push(Equation { left: Tree::name(left), right });
        }
        let (function, total) = (word('F', self.names), word('S', self.names));
        let mut shown = BTreeMap::new();
        let parameters: Vec<&str> =
            objective.subset().iter().map(|p| self.names.parameters[p.index()].as_str()).collect();
        let entries = entries(&function, &parameters);
        let outputs = objective.outputs();
        for (i, output) in outputs.iter().enumerate() {
            let left = match entries.get(i) {
                Some(entry) if entries.len() == outputs.len() => Tree { kind: entry.clone(), span: None },
                _ => Tree::name(&output.name),
            };
            let mut terms: Vec<Addend> = output.terms.iter().map(|term| self.term(term, &total, &mut shown)).collect();
            let kind = match &mut terms[..] {
                [] => Expression::Number(0.0),
                [Addend { coefficient: 1.0, body: Some(_) }] => match terms.pop().and_then(|term| term.body) {
                    Some(body) => body.kind,
                    None => Expression::Number(1.0),
                },
                _ => Expression::Sum(terms),
            };
            self.lines.push(Equation { left, right: Tree { kind, span: None } });
        }
        let mut shown: Vec<(usize, NodeId)> = shown.into_iter().map(|(pixel, number)| (number, pixel)).collect();
        shown.sort_unstable();
        for (i, pixel) in shown {
            let inside = self.at(pixel);
            let right =
                Tree { span: self.expressions.span(pixel), kind: Expression::Total("pixels", Box::new(inside)) };
            self.lines.push(Equation { left: Tree::name(format!("{total}{i}")), right });
        }
        self.lines
    }

    /// coefficient · Σ_rows row · Σ_pixels pixel.
    fn term(&self, term: &OutputTerm, total: &str, shown: &mut BTreeMap<NodeId, usize>) -> Addend {
        let plain = |kind: Expression| Tree { kind, span: None };
        let inner =
            term.pixel.map_or(plain(Expression::Total("pixels", Box::new(plain(Expression::Number(1.0))))), |pixel| {
                let next = shown.len();
                let at = *shown.entry(pixel).or_insert(next);
                Tree::name(format!("{total}{at}"))
            });
        let inner = match term.row.map(|row| self.at(row)) {
            None => inner,
            Some(row) => {
                let mut factors = match row.kind {
                    Expression::Product(factors) => factors,
                    kind => vec![(Tree { kind, ..row }, 1)],
                };
                factors.push((inner, 1));
                plain(Expression::Total("rows", Box::new(plain(Expression::Product(factors)))))
            }
        };
        let (coefficient, body) = match self.at(term.coefficient) {
            Tree { kind: Expression::Number(value), .. } => (value, None),
            Tree { kind: Expression::Sum(mut terms), span } => match (terms.len(), terms.pop()) {
                (1, Some(Addend { coefficient, body })) => (coefficient, body),
                (_, last) => {
                    terms.extend(last);
                    (1.0, Some(Tree { kind: Expression::Sum(terms), span }))
                }
            },
            tree => (1.0, Some(tree)),
        };
        let body = match body {
            None => inner,
            Some(Tree { kind: Expression::Product(mut factors), span }) => {
                factors.push((inner, 1));
                Tree { kind: Expression::Product(factors), span }
            }
            Some(tree) => plain(Expression::Product(vec![(tree, 1), (inner, 1)])),
        };
        Addend { coefficient, body: Some(body) }
    }

    /// The tree of a node, from its operands' trees.
    fn tree(&self, id: NodeId) -> Tree {
        let one = |n: &NodeId| Box::new(self.at(*n));
        let names = self.names;
        let kind = match self.expressions.node(id) {
            Node::Number(bits) => Expression::Number(bits.get()),
            Node::Input(Input::Parameter(p)) => Expression::Name(names.parameters[p.index()].clone()),
            Node::Input(Input::Entry(p)) => Expression::Entry(names.parameters[p.index()].clone()),
            Node::Input(Input::Constant(c)) => Expression::Name(names.constants[c.index()].clone()),
            Node::Input(Input::Saturation(c)) => Expression::Saturation(names.channels[c.index()].clone()),
            Node::Input(Input::Shift(c)) => Expression::Shift(names.coordinates[c.index()].clone()),
            Node::Coordinate(c) => Expression::Name(names.coordinates[c.index()].clone()),
            Node::Channel(c) => Expression::Name(names.channels[c.index()].clone()),
            Node::Sum(constant, terms) => {
                let mut list: Vec<Addend> =
                    terms.iter().map(|(n, c)| Addend { coefficient: c.get(), body: Some(self.at(*n)) }).collect();
                if constant.get() != 0.0 {
                    list.push(Addend { coefficient: constant.get(), body: None });
                }
                Expression::Sum(list)
            }
            Node::Product(factors) => Expression::Product(factors.iter().map(|(n, e)| (self.at(*n), *e)).collect()),
            Node::Sqrt(a) => Expression::Sqrt(one(a)),
            Node::Abs(a) => Expression::Abs(one(a)),
            Node::Call1(f, a) => Expression::Call(f.name(), vec![self.at(*a)]),
            Node::Call2(Function2::Pow, a, b) => Expression::Power(one(a), one(b)),
            Node::Call2(f, a, b) => Expression::Call(f.name(), vec![self.at(*a), self.at(*b)]),
            Node::Gather(lookup, a, b) => {
                let held = [f64::from(lookup.table), f64::from(lookup.coefficient)]
                    .map(|x| Tree { kind: Expression::Number(x), span: None });
                let places = if a == b { vec![self.at(*a)] } else { vec![self.at(*a), self.at(*b)] };
                Expression::Call("cell", held.into_iter().chain(places).collect())
            }
            Node::Compare(c, a, b) => Expression::Compare(*c, one(a), one(b)),
            Node::And(a, b) => Expression::And(one(a), one(b)),
            Node::Or(a, b) => Expression::Or(one(a), one(b)),
            Node::Not(a) => Expression::Not(one(a)),
            Node::Select(c, a, b) => Expression::Select(one(c), one(a), one(b)),
        };
        Tree { kind, span: self.expressions.span(id) }
    }
}

/// Left sides in output order: F, its gradient, its upper Hessian row by row.
fn entries(function: &str, parameters: &[&str]) -> Vec<Expression> {
    let by =
        |names: &[&str]| Expression::Derivative(function.to_string(), names.iter().map(|n| n.to_string()).collect());
    let mut entries = vec![Expression::Name(function.to_string())];
    entries.extend(parameters.iter().map(|u| by(&[u])));
    for (i, u) in parameters.iter().enumerate() {
        entries.extend(parameters[i..].iter().map(|v| by(&[u, v])));
    }
    entries
}
