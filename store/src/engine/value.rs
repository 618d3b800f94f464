//! Values that are bound to statements.

use crate::StoreError;
use sqlx::Arguments;
use sqlx::postgres::PgArguments;
use sqlx::sqlite::SqliteArguments;
use std::fmt::Write;

/// A value to be bound. A number that is not a number is bound as NULL, as SQLite does it: no condition holds
/// for it.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    Int(Option<i64>),
    Real(Option<f64>),
    Bool(bool),
    Text(Option<String>),
    Bytes(Option<Vec<u8>>),
    /// For `IN IDS($n)`.
    Ids(Vec<i64>),
    /// PostgreSQL alone has columns that are made of these.
    Reals(Vec<f64>),
}

impl Value {
    /// Adds it to a statement's values.
    pub fn add_to_sqlite(self, arguments: &mut SqliteArguments) -> Result<(), StoreError> {
        let added = match self {
            Self::Int(value) => arguments.add(value),
            Self::Real(value) => arguments.add(value),
            Self::Bool(value) => arguments.add(value),
            Self::Text(value) => arguments.add(value),
            Self::Bytes(value) => arguments.add(value),
            // To be unpacked by `json_each`: one bound value however many they are.
            Self::Ids(ids) => arguments.add(id_list(&ids)),
            Self::Reals(_) => Err("SQLite has no lists of numbers".into()),
        };
        added.map_err(|error| StoreError::Database(sqlx::Error::Encode(error)))
    }

    /// Adds it to a statement's values.
    pub fn add_to_postgres(self, arguments: &mut PgArguments) -> Result<(), StoreError> {
        let added = match self {
            Self::Int(value) => arguments.add(value),
            Self::Real(value) => arguments.add(value.filter(|value| !value.is_nan())),
            Self::Bool(value) => arguments.add(value),
            Self::Text(value) => arguments.add(value),
            Self::Bytes(value) => arguments.add(value),
            Self::Ids(ids) => arguments.add(ids),
            Self::Reals(reals) => arguments.add(reals),
        };
        added.map_err(|error| StoreError::Database(sqlx::Error::Encode(error)))
    }
}

/// Ids for `IN IDS($n)`. One that no column can hold is as good as any that is not there.
pub(crate) fn ids(ids: impl IntoIterator<Item = u64>) -> Vec<i64> {
    ids.into_iter().map(|id| i64::try_from(id).unwrap_or(i64::MAX)).collect()
}

/// Ids as a JSON array.
fn id_list(ids: &[i64]) -> String {
    let mut list = String::from("[");
    for id in ids {
        if list.len() > 1 {
            list.push(',');
        }
        // Writing to a string cannot fail.
        let _ = write!(list, "{id}");
    }
    list.push(']');
    list
}

macro_rules! values {
    ($($from:ty => $variant:ident, |$value:ident| $to:expr;)*) => {$(
        impl From<$from> for Value {
            fn from($value: $from) -> Self {
                Self::$variant($to)
            }
        }
    )*};
}

values! {
    i64 => Int, |value| Some(value);
    u32 => Int, |value| Some(i64::from(value));
    Option<i64> => Int, |value| value;
    Option<u32> => Int, |value| value.map(i64::from);
    f64 => Real, |value| Some(value);
    Option<f64> => Real, |value| value;
    bool => Bool, |value| value;
    &str => Text, |value| Some(value.to_owned());
    String => Text, |value| Some(value);
    &String => Text, |value| Some(value.clone());
    Option<String> => Text, |value| value;
    &Option<String> => Text, |value| value.clone();
    Option<&str> => Text, |value| value.map(str::to_owned);
    &[u8] => Bytes, |value| Some(value.to_vec());
    Vec<u8> => Bytes, |value| Some(value);
    Option<Vec<u8>> => Bytes, |value| value;
    Vec<i64> => Ids, |value| value;
    Vec<f64> => Reals, |value| value;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn id_lists_are_json() {
        assert_eq!(id_list(&[]), "[]");
        assert_eq!(id_list(&[3]), "[3]");
        assert_eq!(id_list(&[3, 1, i64::MAX]), "[3,1,9223372036854775807]");
    }
}
