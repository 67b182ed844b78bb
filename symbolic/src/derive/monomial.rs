//! Polynomials in pixel and row monomials with coefficients known per pass, into which outputs are split.

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;

use crate::graph::{Bits, Graph, Node, NodeId, Powers};
use crate::program::Level;
use crate::schedule::sums::{Output, Term};

/// A product of powers: of pixel values (summed over the row) and of row values (applied to the row's total).
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub(crate) struct Monomial {
    pub pixel: Powers,
    pub row: Powers,
}

pub(crate) fn multiply(a: &[(NodeId, i32)], b: &[(NodeId, i32)]) -> Powers {
    let mut product = Powers::from_slice(a);
    if b.is_empty() && a.len() < 2 {
        return product;
    }
    product.extend_from_slice(b);
    product.sort_unstable_by_key(|(n, _)| *n);
    product.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        kept.1 += if same { next.1 } else { 0 };
        same
    });
    product.retain(|(_, e)| *e != 0);
    product
}

/// Σ coefficient · monomial.
#[derive(Clone, Debug, Default)]
pub(crate) struct Polynomial {
    /// Ascending.
    terms: Vec<(Monomial, NodeId)>,
}

/// Maximum number of terms of an expansion.
const TERMS: usize = 256;

impl Polynomial {
    pub fn of(monomial: Monomial, coefficient: NodeId) -> Polynomial {
        Polynomial { terms: vec![(monomial, coefficient)] }
    }

    pub fn add(&mut self, graph: &mut Graph, other: &Polynomial) {
        self.terms.reserve(other.terms.len());
        other.terms.iter().for_each(|(monomial, coefficient)| self.add_term(graph, monomial.clone(), *coefficient));
    }

    fn add_term(&mut self, graph: &mut Graph, monomial: Monomial, coefficient: NodeId) {
        let place = self.terms.binary_search_by(|(known, _)| known.cmp(&monomial));
        let total = match place {
            Ok(at) => graph.add2(self.terms[at].1, coefficient),
            Err(_) => coefficient,
        };
        match (place, graph.value_of(total) == Some(0.0)) {
            (Ok(at), true) => drop(self.terms.remove(at)),
            (Ok(at), false) => self.terms[at].1 = total,
            (Err(_), true) => {}
            (Err(at), false) => self.terms.insert(at, (monomial, total)),
        }
    }

    /// The terms.
    pub fn terms(&self) -> &[(Monomial, NodeId)] {
        &self.terms
    }

    /// The product, or `None` when it has too many terms.
    pub fn times(&self, graph: &mut Graph, other: &Polynomial) -> Option<Polynomial> {
        let mut product = Polynomial { terms: Vec::with_capacity(self.terms.len().max(other.terms.len())) };
        if self.terms.len() * other.terms.len() > 4 * TERMS {
            return None;
        }
        graph.charge(4 * self.terms.len() * other.terms.len());
        for (a, ca) in &self.terms {
            for (b, cb) in &other.terms {
                let monomial = Monomial { pixel: multiply(&a.pixel, &b.pixel), row: multiply(&a.row, &b.row) };
                let coefficient = graph.mul(*ca, *cb);
                product.add_term(graph, monomial, coefficient);
            }
        }
        (product.terms.len() <= TERMS).then_some(product)
    }

    /// c · self.
    fn scaled(mut self, graph: &mut Graph, c: f64) -> Polynomial {
        if c != 1.0 {
            graph.charge(4 * self.terms.len());
            let number = graph.number(c);
            self.terms.iter_mut().for_each(|(_, coefficient)| *coefficient = graph.mul(*coefficient, number));
        }
        self
    }

    /// Appends the pixel monomials of the product; `None` when it has too many terms.
    pub fn pixels_with(&self, other: &Polynomial, pixels: &mut Vec<Powers>) -> Option<()> {
        if self.terms.len() * other.terms.len() > TERMS {
            return None;
        }
        for (a, _) in &self.terms {
            pixels.extend(other.terms.iter().map(|(b, _)| multiply(&a.pixel, &b.pixel)));
        }
        Some(())
    }

    pub fn into_terms(self, graph: &mut Graph) -> Vec<Term> {
        let term = |(monomial, coefficient): (Monomial, NodeId)| Term {
            coefficient,
            row: (!monomial.row.is_empty()).then(|| graph.product(1.0, monomial.row)),
            pixel: (!monomial.pixel.is_empty()).then(|| graph.product(1.0, monomial.pixel)),
        };
        self.terms.into_iter().map(term).collect()
    }
}

/// An output that is the sum of one value, whose sums are not split.
pub(crate) fn whole_output(graph: &mut Graph, name: &str, node: NodeId) -> Output {
    let terms = Splitter::new(&BTreeSet::new()).whole(graph, node).into_terms(graph);
    Output { name: name.into(), terms }
}

/// A node's numeric factor and its other factors.
pub(crate) fn factors(graph: &Graph, node: NodeId) -> (f64, Powers) {
    let (number, body) = match graph.node(node) {
        Node::Number(bits) => return (bits.get(), Powers::new()),
        Node::Sum(constant, terms) if terms.len() == 1 && constant.get() == 0.0 => (terms[0].1.get(), terms[0].0),
        _ => (1.0, node),
    };
    match graph.node(body) {
        Node::Product(factors) if !graph.is_opaque(body) => (number, factors.iter().copied().collect()),
        _ => (number, Powers::from_slice(&[(body, 1)])),
    }
}

/// Splits nodes; `atoms` stay whole.
pub(crate) struct Splitter<'a> {
    atoms: &'a BTreeSet<NodeId>,
    /// Cached expansions.
    expanded: FxHashMap<NodeId, Polynomial>,
}

impl<'a> Splitter<'a> {
    pub fn new(atoms: &'a BTreeSet<NodeId>) -> Splitter<'a> {
        Splitter { atoms, expanded: FxHashMap::default() }
    }

    /// The node's invariant factors, row factors and pixel factors; sums are not split.
    pub fn whole(&self, graph: &mut Graph, node: NodeId) -> Polynomial {
        let mut factors = Powers::new();
        let mut coefficient = 1.0;
        let mut pending = Powers::from_slice(&[(node, 1)]);
        while let Some((node, exponent)) = pending.pop() {
            match graph.node(node) {
                Node::Number(bits) => coefficient *= bits.get().powi(exponent),
                Node::Product(list)
                    if !self.atoms.contains(&node) && list.iter().all(|(_, e)| e.checked_mul(exponent).is_some()) =>
                {
                    pending.extend(list.iter().map(|(n, e)| (*n, e * exponent)))
                }
                Node::Sum(c, list) if list.len() == 1 && c.get() == 0.0 => {
                    coefficient *= list[0].1.get().powi(exponent);
                    pending.push((list[0].0, exponent));
                }
                _ => factors.push((node, exponent)),
            }
        }
        let at = |graph: &Graph, level: Level| -> Powers {
            factors.iter().copied().filter(|(n, _)| graph.level(*n) == level).collect()
        };
        let pass = at(graph, Level::Pass);
        let monomial =
            Monomial { pixel: multiply(&at(graph, Level::Pixel), &[]), row: multiply(&at(graph, Level::Row), &[]) };
        let coefficient = graph.product(coefficient, pass);
        Polynomial::of(monomial, coefficient)
    }

    /// The node as a polynomial: expands sums and small powers of sums down to atoms, offsets of coordinates and
    /// non-polynomials.
    pub fn expand(&mut self, graph: &mut Graph, node: NodeId) -> Polynomial {
        self.expand_at(graph, node, 12).unwrap_or_else(|| self.whole(graph, node))
    }

    fn expand_at(&mut self, graph: &mut Graph, node: NodeId, depth: u32) -> Option<Polynomial> {
        let depth = depth.checked_sub(1)?;
        if graph.level(node) != Level::Pixel || self.atoms.contains(&node) {
            return Some(self.whole(graph, node));
        }
        if let Some(known) = self.expanded.get(&node) {
            graph.charge(known.terms.len());
            return Some(known.clone());
        }
        let found = self.multiplied_out(graph, node, depth)?;
        self.expanded.insert(node, found.clone());
        Some(found)
    }

    fn multiplied_out(&mut self, graph: &mut Graph, node: NodeId, depth: u32) -> Option<Polynomial> {
        match graph.node(node).clone() {
            Node::Product(factors) => {
                let one = graph.number(1.0);
                let mut total = Polynomial::of(Monomial::default(), one);
                for (factor, exponent) in factors.iter().copied() {
                    let part = if (1..=4).contains(&exponent) { self.expand_at(graph, factor, depth) } else { None };
                    match part {
                        Some(part) if part.terms.len() > 1 => {
                            for _ in 0..exponent {
                                total = total.times(graph, &part)?;
                            }
                        }
                        _ => {
                            let power = graph.product(1.0, [(factor, exponent)]);
                            let part = self.whole(graph, power);
                            total = total.times(graph, &part)?;
                        }
                    }
                }
                Some(total)
            }
            Node::Sum(constant, terms) if !self.is_atom(graph, node) => {
                let mut total = Polynomial::default();
                for (term, coefficient) in terms.iter().copied() {
                    let part = self.expand_at(graph, term, depth)?.scaled(graph, coefficient.get());
                    total.add(graph, &part);
                }
                if constant.get() != 0.0 {
                    let constant = graph.number(constant.get());
                    total.add(graph, &Polynomial::of(Monomial::default(), constant));
                }
                (total.terms.len() <= TERMS).then_some(total)
            }
            _ => Some(self.whole(graph, node)),
        }
    }

    /// Coordinates and channels with their offsets stay whole (expanding x − bx would cancel), as do shared sums.
    fn is_atom(&self, graph: &Graph, node: NodeId) -> bool {
        let Node::Sum(_, terms) = graph.node(node) else { return true };
        let reads = |terms: &[(NodeId, Bits)]| {
            terms.iter().any(|(n, _)| matches!(graph.node(*n), Node::Coordinate(_) | Node::Channel(_)))
        };
        // An offset of an offset, from a definition.
        let is_shifted = || {
            let mut pixels = terms.iter().filter(|(n, _)| graph.level(*n) == Level::Pixel);
            let first = pixels.next().map(|(n, c)| (graph.node(*n), c.get().abs()));
            pixels.next().is_none() && matches!(first, Some((Node::Sum(_, inner), 1.0)) if reads(inner))
        };
        terms.len() != 1 && (graph.is_opaque(node) || reads(terms) || is_shifted())
    }

    /// The form Σ `pieces` as a polynomial: the invariant factors of each piece, and the rest as an atom.
    pub fn form(graph: &mut Graph, pieces: &[NodeId], atoms: &mut BTreeSet<NodeId>) -> Polynomial {
        let mut total = Polynomial::default();
        for piece in pieces.iter().copied() {
            if graph.value_of(piece) == Some(0.0) {
                continue;
            }
            let part = Splitter::new(&BTreeSet::new()).whole(graph, piece);
            for (monomial, _) in &part.terms {
                atoms.extend(monomial.pixel.iter().map(|(n, _)| *n));
            }
            total.add(graph, &part);
        }
        total
    }
}

/// The terms of a sum with its constant; any other node alone.
pub(crate) fn terms(graph: &mut Graph, node: NodeId) -> Vec<NodeId> {
    let Node::Sum(constant, terms) = graph.node(node).clone() else { return vec![node] };
    let mut pieces: Vec<NodeId> = terms.iter().map(|(n, c)| graph.scale(c.get(), *n)).collect();
    pieces.push(graph.number(constant.get()));
    pieces
}
