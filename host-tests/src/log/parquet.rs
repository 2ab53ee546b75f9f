//! Apache Parquet: columns of numbers, read in batches.

use super::columns::{FIELDS, Fields};
use super::error::{LogError, LogFault};
use super::layout::{Layout, Wanted};
use super::mapping::Column;
use super::rows::{RawRows, open_file};
use parquet::basic::{Compression, Type as PhysicalType};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::schema::types::ColumnDescPtr;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Rows read at once from every column.
const BATCH: usize = 4096;

/// Rows of a Parquet file.
pub(super) struct ParquetRows {
    path: PathBuf,
    file: SerializedFileReader<File>,
    layout: Layout,
    /// The column in the file of every field; `None` for a field that the file lacks.
    columns: [Option<(usize, ColumnDescPtr)>; FIELDS],
    next_group: usize,
    readers: [Option<ColumnReader>; FIELDS],
    batch: [Vec<f64>; FIELDS],
    rows_in_batch: usize,
    next_in_batch: usize,
    number: u64,
}

impl ParquetRows {
    pub(super) fn open(path: &Path, layout: &Layout) -> Result<Self, LogError> {
        let refused = |fault: LogFault| LogError::at(path, 1, fault);
        let file = SerializedFileReader::new(open_file(path)?).map_err(|error| refused(of(&error)))?;
        let schema = file.metadata().file_metadata().schema_descr();
        let mut columns = [const { None }; FIELDS];
        for (column, wanted) in columns.iter_mut().zip(&layout.wanted) {
            *column = find(schema.columns(), wanted.as_ref()).map_err(refused)?;
        }
        check_codecs(&file, columns.iter().flatten().map(|(position, _)| *position)).map_err(refused)?;
        Ok(Self {
            path: path.into(),
            file,
            layout: layout.clone(),
            columns,
            next_group: 0,
            readers: [const { None }; FIELDS],
            batch: std::array::from_fn(|_| Vec::with_capacity(BATCH)),
            rows_in_batch: 0,
            next_in_batch: 0,
            number: 0,
        })
    }

    /// Reads rows ahead. Returns false at the end of the file.
    fn fill(&mut self) -> Result<bool, LogFault> {
        self.next_in_batch = 0;
        loop {
            self.rows_in_batch = self.read_batch()?;
            if self.rows_in_batch > 0 {
                return Ok(true);
            }
            if self.next_group == self.file.num_row_groups() {
                return Ok(false);
            }
            self.open_group()?;
        }
    }

    fn open_group(&mut self) -> Result<(), LogFault> {
        let group = self.file.get_row_group(self.next_group).map_err(|error| of(&error))?;
        self.next_group += 1;
        let open =
            |group: &dyn RowGroupReader, column: usize| group.get_column_reader(column).map_err(|error| of(&error));
        for (reader, column) in self.readers.iter_mut().zip(&self.columns) {
            *reader = column.as_ref().map(|(column, _)| open(&*group, *column)).transpose()?;
        }
        Ok(())
    }

    fn read_batch(&mut self) -> Result<usize, LogFault> {
        let mut rows = 0;
        for (reader, (values, column)) in self.readers.iter_mut().zip(self.batch.iter_mut().zip(&self.columns)) {
            values.clear();
            if let (Some(reader), Some((_, description))) = (reader, column) {
                read_values(reader, description, values)?;
                rows = rows.max(values.len());
            }
        }
        Ok(rows)
    }

    fn take(&mut self, fields: &mut Fields) -> Result<(), LogFault> {
        for (field, (value, values)) in fields.iter_mut().zip(&self.batch).enumerate() {
            *value = values.get(self.next_in_batch).copied().unwrap_or(f64::NAN);
            if self.layout.must_be_finite(field) && !value.is_finite() {
                let column = self.layout.column_name(field);
                let text = value.to_string();
                return Err(if is_null(*value) {
                    LogFault::Null { column }
                } else {
                    LogFault::NotFinite { column, text }
                });
            }
        }
        self.next_in_batch += 1;
        Ok(())
    }
}

impl RawRows for ParquetRows {
    fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, LogError> {
        let row = self.number + 1;
        let at = |path: &Path, fault: LogFault| LogError::at(path, row, fault);
        if self.next_in_batch == self.rows_in_batch && !self.fill().map_err(|fault| at(&self.path, fault))? {
            return Ok(None);
        }
        self.number = row;
        self.take(fields).map_err(|fault| at(&self.path, fault))?;
        Ok(Some(row))
    }
}

fn of(error: &ParquetError) -> LogFault {
    LogFault::Format(format!("not readable as Parquet: {error}"))
}

/// Marks a missing value: a NaN whose bits no arithmetic gives.
const NULL: u64 = 0x7ff8_0000_6e75_6c6c;

fn is_null(value: f64) -> bool {
    value.to_bits() == NULL
}

fn find(columns: &[ColumnDescPtr], wanted: Option<&Wanted>) -> Result<Option<(usize, ColumnDescPtr)>, LogFault> {
    let Some(Wanted { column, required }) = wanted else { return Ok(None) };
    let found = match column {
        Column::Number(number) => Some(number - 1).filter(|position| *position < columns.len()),
        Column::Name(name) => columns.iter().position(|column| column.path().string() == *name),
    };
    let Some(position) = found else {
        return if *required { Err(LogFault::MissingColumn(column.to_string())) } else { Ok(None) };
    };
    let description = &columns[position];
    if !holds_numbers(description) {
        let kind = if description.max_rep_level() > 0 { "lists" } else { "values of type" };
        let found = format!("{kind} {}", description.physical_type());
        return Err(LogFault::NotNumbers { column: column.to_string(), found });
    }
    Ok(Some((position, description.clone())))
}

/// Refuses columns whose compression this program was built without.
fn check_codecs(
    file: &SerializedFileReader<File>,
    columns: impl Iterator<Item = usize> + Clone,
) -> Result<(), LogFault> {
    for group in file.metadata().row_groups() {
        for chunk in columns.clone().filter_map(|position| group.columns().get(position)) {
            let codec = match chunk.compression() {
                Compression::ZSTD(_) => "zstd",
                Compression::BROTLI(_) => "brotli",
                Compression::LZO => "lzo",
                _ => continue,
            };
            return Err(LogFault::Codec { column: chunk.column_path().string(), codec });
        }
    }
    Ok(())
}

fn holds_numbers(column: &ColumnDescPtr) -> bool {
    let numbers = [PhysicalType::INT32, PhysicalType::INT64, PhysicalType::FLOAT, PhysicalType::DOUBLE];
    column.max_rep_level() == 0 && numbers.contains(&column.physical_type())
}

/// Names of the columns of numbers.
///
/// # Errors
/// The file cannot be read.
pub fn parquet_columns(path: &Path) -> Result<Vec<String>, LogError> {
    let file = SerializedFileReader::new(open_file(path)?).map_err(|error| LogError::at(path, 1, of(&error)))?;
    let columns = file.metadata().file_metadata().schema_descr().columns();
    let numbers = columns.iter().filter(|column| holds_numbers(column));
    Ok(numbers.map(|column| column.path().string()).collect())
}

fn read_values(reader: &mut ColumnReader, description: &ColumnDescPtr, values: &mut Vec<f64>) -> Result<(), LogFault> {
    let depth = description.max_def_level();
    match reader {
        ColumnReader::Int32ColumnReader(reader) => read_typed(reader, depth, values, f64::from),
        ColumnReader::Int64ColumnReader(reader) => read_typed(reader, depth, values, |value| value as f64),
        ColumnReader::FloatColumnReader(reader) => read_typed(reader, depth, values, f64::from),
        ColumnReader::DoubleColumnReader(reader) => read_typed(reader, depth, values, |value| value),
        _ => Err(LogFault::Format("a column changed its type".into())),
    }
}

/// Reads values. A value exists where its definition level is the maximum level of the column.
fn read_typed<T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    depth: i16,
    values: &mut Vec<f64>,
    widen: impl Fn(T::T) -> f64,
) -> Result<(), LogFault> {
    let (mut levels, mut present) = (Vec::with_capacity(BATCH), Vec::with_capacity(BATCH));
    let levels_wanted = (depth > 0).then_some(&mut levels);
    let read = reader.read_records(BATCH, levels_wanted, None, &mut present);
    let (rows, ..) = read.map_err(|error| of(&error))?;
    let mut present = present.into_iter().map(widen);
    if depth == 0 {
        values.extend(present);
        return Ok(());
    }
    let next = |level: &i16| if *level == depth { present.next().unwrap_or(f64::NAN) } else { f64::from_bits(NULL) };
    values.extend(levels.iter().take(rows).map(next));
    Ok(())
}
