//! Reports for people: what a command gives as JSON, a figure a line, and lists of like records as tables.

use std::fmt::{self, Write};

use anyhow::Result;
use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

/// A report of JSON, its fields in their order.
enum Figure {
    Missing,
    Text(String),
    List(Vec<Figure>),
    Record(Vec<(String, Figure)>),
}

/// Numbers of a list that are shown; the others are counted.
const SHOWN: usize = 12;

/// The text for a report in JSON. Of the records of a list, single values alone are shown.
pub(crate) fn for_people(json: &str) -> Result<String> {
    let mut lines = Vec::new();
    let mut tables = String::new();
    serde_json::from_str::<Figure>(json)?.collect(String::new(), &mut lines, &mut tables);
    let width = lines.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for (name, value) in lines {
        writeln!(text, "{name:width$}  {value}")?;
    }
    Ok(text + &tables)
}

impl Figure {
    fn collect(&self, name: String, lines: &mut Vec<(String, String)>, tables: &mut String) {
        match self {
            Self::Record(fields) => {
                for (field, figure) in fields {
                    let path = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
                    figure.collect(path, lines, tables);
                }
            }
            Self::List(items) if items.iter().any(|item| matches!(item, Self::Record(_))) => {
                *tables += &format!("{name}:\n{}", table(items));
            }
            Self::Missing | Self::Text(_) | Self::List(_) => lines.push((name, self.value())),
        }
    }

    /// In one line.
    fn value(&self) -> String {
        match self {
            Self::Missing => "–".to_owned(),
            Self::Text(text) => text.clone(),
            Self::List(items) => {
                let shown: Vec<String> = items.iter().take(SHOWN).map(Self::value).collect();
                let more = items.len().saturating_sub(SHOWN);
                let more = if more == 0 { String::new() } else { format!(", and {more} more") };
                format!("[{}{more}]", shown.join(", "))
            }
            Self::Record(_) => String::new(),
        }
    }

    /// The single values of a record.
    fn cells(&self) -> Vec<(&str, String)> {
        let Self::Record(fields) = self else { return Vec::new() };
        let single = |figure: &Self| matches!(figure, Self::Missing | Self::Text(_));
        let single = fields.iter().filter(|(_, figure)| single(figure));
        single.map(|(name, figure)| (name.as_str(), figure.value())).collect()
    }
}

/// A row for each record, under the names of the first one's fields.
fn table(records: &[Figure]) -> String {
    let names: Vec<&str> =
        records.first().map(Figure::cells).unwrap_or_default().into_iter().map(|(name, _)| name).collect();
    let row = |record: &Figure| {
        let cells = record.cells();
        let cell =
            |name: &&str| cells.iter().find(|(of, _)| of == name).map_or("", |(_, value)| value).to_owned();
        names.iter().map(cell).collect::<Vec<String>>()
    };
    let header = names.iter().map(|&name| name.to_owned()).collect();
    let rows: Vec<Vec<String>> = std::iter::once(header).chain(records.iter().map(row)).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..names.len()).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, &width)| format!("  {cell:>width$}"));
        cells.collect::<String>() + "\n"
    };
    rows.iter().map(line).collect()
}

/// Four digits that say something; whole numbers whole.
fn digits(number: f64) -> String {
    if number == 0.0 || !number.is_finite() || number.fract() == 0.0 && number.abs() < 1e15 {
        return number.to_string();
    }
    let decimals = (3.0 - number.abs().log10().floor()).clamp(0.0, 9.0);
    format!("{number:.*}", decimals as usize)
}

impl<'de> Deserialize<'de> for Figure {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Fields)
    }
}

/// Reads fields in the order in which they come: a map of `serde_json` has them by name.
struct Fields;

impl<'de> Visitor<'de> for Fields {
    type Value = Figure;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a report")
    }

    fn visit_unit<E>(self) -> Result<Figure, E> {
        Ok(Figure::Missing)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Figure, E> {
        Ok(Figure::Text(if value { "yes" } else { "no" }.to_owned()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Figure, E> {
        Ok(Figure::Text(value.to_string()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Figure, E> {
        Ok(Figure::Text(value.to_string()))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Figure, E> {
        Ok(Figure::Text(digits(value)))
    }

    fn visit_str<E: de::Error>(self, value: &str) -> Result<Figure, E> {
        Ok(Figure::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Figure, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Figure::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Figure, A::Error> {
        let mut record = Vec::new();
        while let Some(field) = fields.next_entry()? {
            record.push(field);
        }
        Ok(Figure::Record(record))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_lines_and_records_are_rows() {
        let report = r#"{"frames": 3, "recall": 0.123456, "met": true, "ece": null, "took": {"ms": 1234.5},
            "by_half": [0.5, 12.0], "runs": [{"seed": 7, "path": [1], "error_m": 0.25}, {"seed": 10, "error_m": null}]}"#;
        let text = "frames   3\nrecall   0.1235\nmet      yes\nece      –\ntook.ms  1234\nby_half  [0.5000, 12]\n\
                    runs:\n  seed  error_m\n     7   0.2500\n    10        –\n";
        assert_eq!(for_people(report).unwrap(), text);
    }

    #[test]
    fn long_lists_are_cut_and_small_numbers_keep_their_digits() {
        let text = for_people(&format!("{{\"counts\": {:?}, \"cost\": 0.00001234}}", vec![1; 20])).unwrap();
        assert!(text.contains("1, and 8 more]") && text.contains("0.00001234"), "{text}");
        assert_eq!(for_people("[]").unwrap(), "  []\n");
    }
}
