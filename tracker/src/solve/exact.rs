//! Bit-exact serde for numbers: finite ones as numbers, whose shortest decimal is exact, the others as words of hexadecimal
//! bits, since JSON has no NaN or infinity.

use nalgebra::{DMatrix, Vector3};
use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::{Serialize, Serializer};

/// Types made of such numbers.
pub(crate) trait Exact: Sized {
    /// Writes it.
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error>;

    /// Reads it.
    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error>;
}

/// For serde.
pub(crate) fn serialize<T: Exact, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
    value.write(serializer)
}

/// For serde.
pub(crate) fn deserialize<'de, T: Exact, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    T::read(deserializer)
}

struct Lent<'a, T>(&'a T);

impl<T: Exact> Serialize for Lent<'_, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.write(serializer)
    }
}

struct Owned<T>(T);

impl<'de, T: Exact> Deserialize<'de> for Owned<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Owned<T>, D::Error> {
        T::read(deserializer).map(Owned)
    }
}

#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Written {
    Finite(f64),
    Word(String),
}

impl Exact for f64 {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.is_finite() {
            true => serializer.serialize_f64(*self),
            false => serializer.serialize_str(&format!("{:016x}", self.to_bits())),
        }
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        match Written::deserialize(deserializer)? {
            Written::Finite(number) => Ok(number),
            Written::Word(bits) => u64::from_str_radix(&bits, 16).map(f64::from_bits).map_err(D::Error::custom),
        }
    }
}

impl<T: Exact> Exact for Option<T> {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.as_ref().map(Lent).serialize(serializer)
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
        Ok(Option::<Owned<T>>::deserialize(deserializer)?.map(|Owned(value)| value))
    }
}

impl<T: Exact> Exact for Vec<T> {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter().map(Lent))
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
        Ok(Vec::<Owned<T>>::deserialize(deserializer)?.into_iter().map(|Owned(value)| value).collect())
    }
}

impl<T: Exact, const N: usize> Exact for [T; N] {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter().map(Lent))
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[T; N], D::Error> {
        let values = Vec::<T>::read(deserializer)?;
        let found = values.len();
        values.try_into().map_err(|_| D::Error::custom(format!("{found} values in the place of {N}")))
    }
}

impl<A: Exact, B: Exact> Exact for (A, B) {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (Lent(&self.0), Lent(&self.1)).serialize(serializer)
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(A, B), D::Error> {
        let (Owned(a), Owned(b)) = Deserialize::deserialize(deserializer)?;
        Ok((a, b))
    }
}

impl Exact for Vector3<f64> {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        <[f64; 3]>::from(*self).write(serializer)
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vector3<f64>, D::Error> {
        <[f64; 3]>::read(deserializer).map(Vector3::from)
    }
}

/// As rows of equal length.
impl Exact for DMatrix<f64> {
    fn write<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<Vec<f64>> = self.row_iter().map(|row| row.iter().copied().collect()).collect();
        rows.write(serializer)
    }

    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DMatrix<f64>, D::Error> {
        let rows = Vec::<Vec<f64>>::read(deserializer)?;
        let columns = rows.first().map_or(0, Vec::len);
        if rows.iter().any(|row| row.len() != columns) {
            return Err(D::Error::custom("rows of a matrix differ in length"));
        }
        Ok(DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j]))
    }
}
