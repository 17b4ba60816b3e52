//! Many rows in one statement: each statement is a round trip to the database.

/// Numbers of rows that a statement may have: few, since the database prepares a statement for each.
const SIZES: [usize; 3] = [MOST_ROWS, 8, 1];

/// Rows that one statement has at most.
pub(super) const MOST_ROWS: usize = 64;

/// A statement for each number of rows.
#[derive(Debug)]
pub(super) struct Statements([String; SIZES.len()]);

impl Statements {
    /// `sql` gets the rows as a table that databases call `(VALUES ($1, $2), ($3, $4))`, with `columns` values in a row,
    /// which are named `column1` and so on.
    pub(super) fn new(columns: usize, sql: impl Fn(&str) -> String) -> Self {
        Self(SIZES.map(|rows| sql(&values(rows, columns))))
    }

    /// The statement for the first of some rows, which there are, and how many these are.
    pub(super) fn for_first(&self, rows: usize) -> (&str, usize) {
        let which = SIZES.iter().position(|size| *size <= rows).unwrap_or(SIZES.len() - 1);
        (&self.0[which], SIZES[which])
    }
}

fn values(rows: usize, columns: usize) -> String {
    let row = |row: usize| {
        let values: Vec<String> =
            (1..=columns).map(|column| format!("${}", row * columns + column)).collect();
        format!("({})", values.join(", "))
    };
    format!("(VALUES {})", (0..rows).map(row).collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_have_the_rows_that_are_left() {
        let statements = Statements::new(2, str::to_owned);
        assert_eq!(statements.for_first(1), ("(VALUES ($1, $2))", 1));
        assert_eq!(statements.for_first(7).1, 1);
        let (sql, rows) = statements.for_first(63);
        assert_eq!((rows, &sql[..35]), (8, "(VALUES ($1, $2), ($3, $4), ($5, $6"));
        assert!(sql.ends_with("($15, $16))"));
        assert_eq!(statements.for_first(64).1, 64);
        assert_eq!(statements.for_first(1000).1, 64);
    }
}
