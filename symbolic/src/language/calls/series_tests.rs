//! Sums and products equal their factored form.
#![allow(clippy::unwrap_used)]
use crate::Model;

/// A model with intensity `a` and noise `b` in one graph, so that equal formulas are equal nodes.
fn model(a: &str, b: &str) -> Model {
    let text = format!(
        "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\n{}[definitions]\nk = \"[1, p, q, v]\"\n\
         \"g(t)\" = \"sin(t*p) + t\"\n\"h(t)\" = \"t*sum(k[j]*x^j, j, 0, 3)\"\n[model]\nintensity = \"{a}\"\nnoise = \"{b}\"\n",
        ["p", "q", "v", "w"].map(|n| format!("{n} = {{ start = 1.0 }}\n")).concat()
    );
    Model::from_toml(&text).unwrap_or_else(|d| panic!("{a}: {d:?}"))
}

#[test]
fn index_independent_factors_leave_the_sum() {
    let table = [
        ("sum(v*k[i]*x^i, i, 0, 3)", "v*sum(k[i]*x^i, i, 0, 3)"),
        ("sum(k[i]*v*x^i/w, i, 0, 3)", "v/w*sum(k[i]*x^i, i, 0, 3)"),
        ("sum(-v*k[i], i, 0, 3)", "-(v*sum(k[i], i, 0, 3))"),
        ("sum(w + v*k[i], i, 0, 3)", "4*w + v*sum(k[i], i, 0, 3)"),
        ("sum(v*(w + k[i]), i, 1, 3)", "v*(3*w + sum(k[i], i, 1, 3))"),
        ("sum(v*w, i, 0, 9)", "10*v*w"),
        ("product(v*g(i), i, 1, 3)", "v^3*product(g(i), i, 1, 3)"),
        ("product(g(i)/v, i, 1, 3)", "product(g(i), i, 1, 3)/v^3"),
        ("product(v, i, 0, 4)", "v^5"),
        ("sum(sum(k[i]*sin(j*p)*v, j, 0, 3), i, 0, 3)", "v*sum(sin(j*p), j, 0, 3)*sum(k[i], i, 0, 3)"),
        ("sum(g(v)*k[i], i, 0, 3)", "g(v)*sum(k[i], i, 0, 3)"),
        ("(sum([[v, w], [p, q]]*[k[i], i], i, 0, 3))[0]", "([[v, w], [p, q]]*[sum(k[i], i, 0, 3), 6])[0]"),
        ("sum([x, v]'*[k[i], i]*w, i, 0, 3)", "([x, v]'*[sum(k[i], i, 0, 3), 6])*w"),
    ];
    for (a, b) in table {
        let model = model(a, b);
        let (a_node, b_node) = (model.formulas.entries[0].intensity, model.formulas.entries[0].noise.unwrap());
        assert_eq!(a_node, b_node, "{a} is not {b}");
    }
}

/// A sum costs as much as its factored form.
#[test]
fn sums_cost_no_more_than_their_factored_form() {
    let flops = |formula: &str| {
        let model = model(formula, "1");
        let objective = model.objective(&model.stages()[0].parameters, crate::Method::GaussNewton).unwrap();
        objective.cost(Default::default()).unwrap().flops_per_pixel
    };
    assert_eq!(flops("sum(v*exp(-w*x)*k[i]*x^i, i, 0, 3)"), flops("v*exp(-w*x)*sum(k[i]*x^i, i, 0, 3)"));
    assert!(flops("sum(v*exp(-w*x)*k[i]*x^i, i, 0, 3)") < 100);
}

/// Parts shared by a thousand terms are elaborated once: else this would take millions of steps.
#[test]
fn shared_parts_are_elaborated_once() {
    let inner = "sum(sin(j*x), j, 0, 900)";
    model(&format!("p*sum((i + {inner})^2, i, 0, 900)"), "1");
    model("p*sum(cos(i*p + h(x)), i, 0, 900)", "1");
    model("p*sum(cos(i*p)*h(i), i, 0, 900)", "1");
}
