//! Fills scenes from tables of numbers that readers convert to floats: the arrays of glTF and of USD.

use crate::error::SceneError;
use crate::input::{Buffers, Done, Input, in_pieces};
use crate::scene::{Columns, Gathered, Rows};

/// Number of rows that a thread reads at a time.
pub(crate) const ROWS: usize = 4096;

/// A table of numbers in a file, with a row for each splat.
pub(crate) trait Floats: Sync {
    fn width(&self) -> usize;

    /// Returns the size of a row's numbers in the file, in bytes.
    fn bytes(&self) -> usize;

    /// Returns the distance in bytes from one row to the next.
    fn stride(&self) -> usize;

    /// Reads rows from index `first` on, as many as fill `out`. `buffer` is scratch memory of one stride per row.
    fn read(&self, first: usize, buffer: &mut [u8], out: &mut [f32]) -> Result<(), SceneError>;
}

/// Rows of a table, as floats.
#[derive(Clone, Copy, Default)]
pub(crate) struct Piece<'a> {
    values: &'a [f32],
    width: usize,
}

impl<'a> Piece<'a> {
    pub(crate) fn row(&self, at: usize) -> &'a [f32] {
        &self.values[at * self.width..][..self.width]
    }
}

/// Allocates a scene of `count` splats, and fills it in parallel from tables. `held` are bytes that the reader has in
/// memory.
///
/// `convert` gets a piece of every table and the index of a row in it, and pushes one splat.
pub(crate) fn fill<T: Floats>(
    input: &Input,
    (count, degree): (u64, u32),
    tables: &[T],
    held: u64,
    done: &Done,
    convert: impl Fn(&[Piece], usize, &mut Rows) + Sync,
) -> Result<(Columns, Gathered), SceneError> {
    let row: usize = tables.iter().map(Floats::width).sum();
    let read: usize = tables.iter().map(Floats::bytes).sum();
    let stride = tables.iter().map(Floats::stride).max().unwrap_or(0);
    let scratch = ROWS.min(count as usize) * (stride + size_of::<f32>() * row);
    let mut columns = input.allocate(count, degree, false, (scratch, held))?;
    let buffers = Buffers::default();
    let gathered = columns.fill(|out| {
        let most = ROWS.min(out.len());
        buffers.with(most * stride, |buffer| {
            let mut values = vec![0f32; most * row];
            in_pieces(out, most, done, |first, rows, out| {
                let mut left = &mut values[..rows * row];
                let mut pieces = Vec::with_capacity(tables.len());
                for table in tables {
                    let (values, others) = left.split_at_mut(rows * table.width());
                    table.read(first, buffer, values)?;
                    pieces.push(Piece { values, width: table.width() });
                    left = others;
                }
                (0..rows).for_each(|at| convert(&pieces, at, out));
                Ok(rows * read)
            })
        })
    })?;
    Ok((columns, gathered))
}
