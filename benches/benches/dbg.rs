#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]
use isophote_benches::{scene::Scene, search};
use isophote_tracker::{Tracker, TrackerOptions};
fn main() {
    for noise in [false, true] {
        let compiled = search::compiled(noise);
        let mut shown = 0;
        for seed in 0..300u64 {
            let scene = Scene::new(seed + 1_000_000, 30.0, 10);
            let frame = scene.frame();
            let t = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
            let s = t.sightings(&frame);
            let target = scene.target.unwrap();
            let d = |p: &[f64], c: [f64;2]| (p[0]-c[0]).hypot(p[1]-c[1]);
            if !s.is_empty() && d(&s[0].parameters, target.centre) < 2.0 { continue; }
            shown += 1;
            println!("noise {noise} seed {seed} target {:?}", target);
            for one in s.iter().take(3).chain(s.iter().filter(|o| d(&o.parameters, target.centre) < 2.0)) {
                let near = scene.clutter.iter().chain(&scene.target).min_by(|a,b| d(&one.parameters,a.centre).total_cmp(&d(&one.parameters,b.centre))).unwrap();
                println!("   {:.4?} {:.3?} near {:?} {:.0?} h {:.0}  d {:.1} conf {:.4}", &one.parameters, one.evidence.unwrap(), near.profile, near.half, near.height, d(&one.parameters, near.centre), one.evidence.unwrap().confidence());
            }
        }
        println!("noise {noise} failed {shown}");
    }
}
