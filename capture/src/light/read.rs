//! Parses and range-checks a [`Light`] document, and evaluates it at a time.

use std::fmt;

use isophote_frame::{NUMBER_MAX, plain};

use super::{Blind, Glare, Light, Occluder};
use crate::limits::LIMITS;
use crate::moving::{Law, Moving, MovingFault, Range};

/// Positions, px.
const ANYWHERE: Range = Range::Between(-NUMBER_MAX, NUMBER_MAX);
/// Numbers of columns or rows.
const SIDE: Range = Range::NotNegativeTo(NUMBER_MAX);
/// Light, DN.
const DN: Range = Range::Between(0.0, LIMITS.light_dn);
/// Slope of the light, DN/px.
const SLOPE: Range = Range::Between(-LIMITS.light_dn, LIMITS.light_dn);
/// Standard deviation of a veil, px.
const SOFT: Range = Range::Between(0.0, LIMITS.glare_px);
/// Standard deviation of a lobe, px.
const LOBE: Range = Range::PositiveTo(LIMITS.glare_px);
/// Standard deviation of the defocus, px.
const BLUR: Range = Range::Between(0.0, LIMITS.defocus_px);

/// Exposures and gains.
const FACTOR: Range = Range::PositiveTo(LIMITS.light_factor);

/// Path of a number in the document.
#[derive(Clone, Copy)]
struct Key {
    list: &'static str,
    index: Option<usize>,
    field: &'static str,
}

impl fmt::Display for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        write!(formatter, "light.{}", self.list)?;
        if let Some(index) = self.index {
            write!(formatter, "[{index}]")?;
        }
        if self.field.is_empty() { Ok(()) } else { write!(formatter, ".{}", self.field) }
    }
}

/// Key and fault.
pub(crate) type LightFault = (String, MovingFault);

/// Parses the formulas and checks the numbers.
pub(crate) fn read(light: &Light<Moving>) -> Result<Light<Law>, LightFault> {
    let lists = [
        ("glare", light.glare.len()),
        ("occluders", light.occluders.len()),
        ("blind", light.blind.len()),
        ("hot", light.hot.len()),
    ];
    for (list, length) in lists {
        if length > LIMITS.light_items {
            let most = LIMITS.light_items;
            return Err((format!("light.{list}"), MovingFault::Range(format!("has {length} entries; {most} at most"))));
        }
    }
    for (index, one) in light.hot.iter().enumerate() {
        let is_share = (0.0..=1.0).contains(&one.share);
        let is_range = [one.least, one.most].iter().all(|dn| dn.abs() <= LIMITS.light_dn) && one.least <= one.most;
        if !is_share || !is_range {
            let most = LIMITS.light_dn;
            let reason = format!("needs a share from 0 to 1, and least up to most, each from -{most} to {most}");
            return Err((format!("light.hot[{index}]"), MovingFault::Range(reason)));
        }
    }
    let times = light.glare.iter().map(|one| ("glare", one.from_s, one.to_s));
    let times = times.chain(light.occluders.iter().map(|one| ("occluders", one.from_s, one.to_s)));
    for (list, from_s, to_s) in times.chain(light.blind.iter().map(|one| ("blind", one.from_s, one.to_s))) {
        if let Some(time_s) = [from_s, to_s]
            .into_iter()
            .flatten()
            .find(|time_s| !(-LIMITS.light_time_s..=LIMITS.light_time_s).contains(time_s))
        {
            let reason = format!("has a time of {} s; it must be from -1e10 to 1e10", plain(time_s));
            return Err((format!("light.{list}"), MovingFault::Range(reason)));
        }
        if from_s.zip(to_s).is_some_and(|(from_s, to_s)| from_s >= to_s) {
            let reason = "has a time that ends before it begins: from_s must be less than to_s".to_string();
            return Err((format!("light.{list}"), MovingFault::Range(reason)));
        }
    }
    light.each(&mut |key, range, moving| Law::read(moving, range).map_err(|fault| (key.to_string(), fault)))
}

/// The defects present at time `t_s`, evaluated then; a message if a number is out of range.
pub(crate) fn at(light: &Light<Law>, t_s: f64) -> Result<Light<f64>, String> {
    let is_there = |from_s: Option<f64>, to_s: Option<f64>| {
        from_s.is_none_or(|from| t_s >= from) && to_s.is_none_or(|to| t_s < to)
    };
    let mut values =
        light.each(&mut |key, range, law: &Law| law.at(t_s, range).map_err(|reason| format!("`{key}` {reason}")))?;
    values.glare.retain(|one| is_there(one.from_s, one.to_s));
    values.occluders.retain(|one| is_there(one.from_s, one.to_s));
    values.blind.retain(|one| is_there(one.from_s, one.to_s));
    Ok(values)
}

/// Reads the exposure or gain named `key`.
pub(crate) fn read_factor(key: &str, factor: &Moving) -> Result<Law, LightFault> {
    Law::read(factor, FACTOR).map_err(|fault| (key.to_string(), fault))
}

/// The factor at time `t_s`.
pub(crate) fn factor_at(key: &str, factor: &Law, t_s: f64) -> Result<f64, String> {
    factor.at(t_s, FACTOR).map_err(|reason| format!("`{key}` {reason}"))
}

impl<T> Light<T> {
    /// Maps every number with `make`, which gets its key and its range.
    fn each<U, E>(&self, make: &mut impl FnMut(Key, Range, &T) -> Result<U, E>) -> Result<Light<U>, E> {
        let alone = |list| Key { list, index: None, field: "" };
        let defocus_px = self.defocus_px.as_ref().map(|px| make(alone("defocus_px"), BLUR, px)).transpose()?;
        let slope = match &self.slope {
            None => None,
            Some([x, y]) => {
                let key = |index| Key { index: Some(index), ..alone("slope") };
                Some([make(key(0), SLOPE, x)?, make(key(1), SLOPE, y)?])
            }
        };
        let mut light = Light { defocus_px, slope, hot: self.hot.clone(), ..Light::default() };
        for (index, one) in self.glare.iter().enumerate() {
            light.glare.push(one.each(Key { index: Some(index), ..alone("glare") }, make)?);
        }
        for (index, one) in self.occluders.iter().enumerate() {
            light.occluders.push(one.each(Key { index: Some(index), ..alone("occluders") }, make)?);
        }
        for (index, one) in self.blind.iter().enumerate() {
            light.blind.push(one.each(Key { index: Some(index), ..alone("blind") }, make)?);
        }
        Ok(light)
    }
}

impl<T> Glare<T> {
    fn each<U, E>(&self, key: Key, make: &mut impl FnMut(Key, Range, &T) -> Result<U, E>) -> Result<Glare<U>, E> {
        let mut of = |field, range, value| make(Key { field, ..key }, range, value);
        Ok(Glare {
            x: self.x.as_ref().map(|x| of("x", ANYWHERE, x)).transpose()?,
            y: self.y.as_ref().map(|y| of("y", ANYWHERE, y)).transpose()?,
            sigma_px: of("sigma_px", LOBE, &self.sigma_px)?,
            height: of("height", DN, &self.height)?,
            from_s: self.from_s,
            to_s: self.to_s,
        })
    }
}

impl<T> Occluder<T> {
    fn each<U, E>(&self, key: Key, make: &mut impl FnMut(Key, Range, &T) -> Result<U, E>) -> Result<Occluder<U>, E> {
        let mut of = |field, range, value| make(Key { field, ..key }, range, value);
        Ok(Occluder {
            x: self.x.as_ref().map(|x| of("x", ANYWHERE, x)).transpose()?,
            y: self.y.as_ref().map(|y| of("y", ANYWHERE, y)).transpose()?,
            width: self.width.as_ref().map(|width| of("width", SIDE, width)).transpose()?,
            height: self.height.as_ref().map(|height| of("height", SIDE, height)).transpose()?,
            value: of("value", DN, &self.value)?,
            from_s: self.from_s,
            to_s: self.to_s,
        })
    }
}

impl<T> Blind<T> {
    fn each<U, E>(&self, key: Key, make: &mut impl FnMut(Key, Range, &T) -> Result<U, E>) -> Result<Blind<U>, E> {
        let mut of = |field, range, value| make(Key { field, ..key }, range, value);
        Ok(Blind {
            x: self.x.as_ref().map(|x| of("x", ANYWHERE, x)).transpose()?,
            y: self.y.as_ref().map(|y| of("y", ANYWHERE, y)).transpose()?,
            width: self.width.as_ref().map(|width| of("width", SIDE, width)).transpose()?,
            height: self.height.as_ref().map(|height| of("height", SIDE, height)).transpose()?,
            soft_px: self.soft_px.as_ref().map(|px| of("soft_px", SOFT, px)).transpose()?,
            from_s: self.from_s,
            to_s: self.to_s,
        })
    }
}
