//! Columns of numbers over time, as they come out of a log. Every number is an `f64`, which is
//! exact for all fields except integers beyond 2^53.

/// One field of a signal over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Field name, unit last.
    pub name: String,
    /// Elements a row; 1 for a scalar.
    pub width: usize,
    /// True when the field is an array, also of one element.
    pub array: bool,
    /// Rows one after another, `width` numbers each.
    pub values: Vec<f64>,
}

impl Column {
    /// The elements of a row; empty when there is no such row.
    #[must_use]
    pub fn row(&self, row: usize) -> &[f64] {
        let start = row.saturating_mul(self.width);
        self.values.get(start..start.saturating_add(self.width)).unwrap_or_default()
    }

    /// One element over all rows; empty when there is no such element.
    #[must_use]
    pub fn element(&self, index: usize) -> Vec<f64> {
        if index >= self.width {
            return Vec::new();
        }
        self.values.iter().skip(index).step_by(self.width).copied().collect()
    }
}

/// A signal over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Logical time of each row in s since the start of the run.
    pub t_s: Vec<f64>,
    /// Job that wrote each row.
    pub tick: Vec<u64>,
    /// Fields in order.
    pub columns: Vec<Column>,
}

impl Series {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// True when there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// A field by its name.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// A scalar field, or element `index` of an array field, over all rows; empty when there is
    /// none.
    #[must_use]
    pub fn values(&self, name: &str, index: usize) -> Vec<f64> {
        self.column(name).map(|column| column.element(index)).unwrap_or_default()
    }

    /// The last row at or before `t_s`; the first row when all are later; `None` when there is no
    /// row.
    #[must_use]
    pub fn row_at(&self, t_s: f64) -> Option<usize> {
        let after = self.t_s.partition_point(|t| *t <= t_s);
        (!self.is_empty()).then(|| after.saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_elements_and_times() {
        let column =
            Column { name: "q".into(), width: 2, array: true, values: vec![1.0, 2.0, 3.0, 4.0] };
        assert_eq!(column.row(1), [3.0, 4.0]);
        assert!(column.row(2).is_empty());
        assert_eq!(column.element(1), [2.0, 4.0]);
        assert!(column.element(2).is_empty());
        let series = Series { t_s: vec![0.0, 1.0], tick: vec![0, 1], columns: vec![column] };
        assert_eq!(series.row_at(-1.0), Some(0));
        assert_eq!(series.row_at(0.99), Some(0));
        assert_eq!(series.row_at(7.0), Some(1));
        assert_eq!(series.values("q", 0), [1.0, 3.0]);
        assert!(series.values("nothing", 0).is_empty());
        assert_eq!(Series::default().row_at(0.0), None);
    }
}
