//! Hostile documents whose cost is in their schedules: many stages, parameters and observed values, and Hessians of them.

use super::Ending::{self, Honest};

/// A document of `channels` raw planes, 64 parameters, and a stage for each of `stages`.
fn document(channels: usize, definitions: &str, model: &str, stages: &[(Vec<usize>, &str)]) -> String {
    let quoted = |names: Vec<String>| names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ");
    let channels = quoted((0..channels).map(|i| format!("c{i}")).collect());
    let parameters: String = (0..64).map(|i| format!("p{i} = {{ start = 0.1 }}\n")).collect();
    let stage = |(free, method): &(Vec<usize>, &str)| {
        let free = quoted(free.iter().map(|i| format!("p{i}")).collect());
        format!("[[stages]]\nparameters = [{free}]\nmethod = \"{method}\"\n")
    };
    let stages: String = stages.iter().map(stage).collect();
    format!(
        "name = \"bomb\"\ncoordinates = [\"x\", \"y\"]\nchannels = [{channels}]\n[parameters]\n{parameters}[definitions]\n{definitions}[model]\n{model}{stages}"
    )
}

/// Stages of the same parameters, each in another order.
fn turned(count: usize, method: &'static str) -> Vec<(Vec<usize>, &'static str)> {
    (0..count).map(|k| ((0..64).map(|i| (i + k) % 64).collect(), method)).collect()
}

fn entries(formula: &str, count: usize) -> String {
    format!("intensity = \"[{}]\"\n", vec![formula; count].join(", "))
}

/// Every document of this kind.
pub fn all(add: &mut impl FnMut(&'static str, String, Ending)) {
    let vector = format!("P = \"[{}]\"\n", (0..64).map(|i| format!("p{i}")).collect::<Vec<_>>().join(", "));
    let surface = vector.clone() + "u = \"sum(sum(P[8*i + j]*(x/40)^i*(y/40)^j, j, 0, 7), i, 0, 7)\"\n";
    let steps = |terms: usize| format!("{surface}m = \"sum(tanh(k*u/100), k, 1, {terms})\"\n");
    let newton = turned(1, "newton");
    add("a Hessian of 64 parameters", document(1, &surface, "intensity = \"exp(-u^2)\"\n", &newton), Honest);
    add("a Hessian of 64 parameters, 100 terms", document(1, &steps(100), "intensity = \"m\"\n", &newton), Honest);
    add("a Hessian of 64 parameters, 800 terms", document(1, &steps(800), "intensity = \"m\"\n", &newton), Honest);
    let censored = "loss = \"tukey(5)\"\nsaturated = \"censored\"\n";
    let full = entries("m", 8) + censored;
    add("800 terms in 16 summands and 8 turned stages", document(8, &steps(800), &full, &turned(8, "newton")), Honest);
    let linear = entries("P' * P * x + P[0]", 8) + censored;
    for (name, method) in [
        ("8 stages, 64 parameters, 16 summands, Newton", "newton"),
        ("8 stages, 64 parameters, 16 summands", "levenberg-marquardt"),
    ] {
        add(name, document(8, &vector, &linear, &turned(8, method)), Honest);
    }
    let same: Vec<_> = (0..8).map(|_| ((0..64).collect(), "newton")).collect();
    add("8 stages alike", document(1, &surface, "intensity = \"exp(-u^2)\"\n", &same), Honest);
    let sines = (0..64).map(|i| format!("sin(p{i}*x)*cos(p{}*y)", (i + 1) % 64)).collect::<Vec<_>>();
    let sines = format!("intensity = \"{}\"\n", sines.join(" + "));
    add("64 waves, Newton", document(1, "", &sines, &newton), Honest);
    let noisy = sines.clone() + "noise = \"1 + intensity^2\"\n";
    add("64 waves with a noise of their own, Newton", document(1, "", &noisy, &newton), Honest);
    let powers = (0..64).map(|i| format!("(x + p{i})^{}", i + 1)).collect::<Vec<_>>().join("*");
    add("a product of 64 powers, Newton", document(1, "", &format!("intensity = \"{powers}\"\n"), &newton), Honest);
    let long: Vec<String> = (0..600).map(|i| format!("p{}*x^{}*y^{}", i % 64, i % 25, i / 25)).collect();
    let long = entries(&long.join(" + "), 1) + "saturated = \"censored\"\n";
    add("a polynomial of 600 terms, 8 stages", document(1, "", &long, &turned(8, "newton")), Honest);
    let wide = "d = \"sum(P[0]*sin(x), i, 0, 0)\"\n".to_string();
    let wide = document(
        8,
        &(vector + &wide),
        &(entries("exp(d)*P[1]", 8) + "noise = \"1 + intensity\"\n"),
        &turned(8, "newton"),
    );
    add("8 stages, 8 values with noise", wide, Honest);
    let large: String = (0..900).map(|i| format!("sin(p{}*x + {i})", i % 64)).collect::<Vec<_>>().join(" + ");
    add(
        "900 waves seen by 8 channels",
        document(8, &format!("w = \"{large}\"\n"), &(entries("w", 8) + censored), &turned(8, "gauss-newton")),
        Honest,
    );
}
