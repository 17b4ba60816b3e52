//! Tables for spreadsheets and scripts hold what the lists hold.

use serde_json::{Value, json};

use crate::harness::{Surveyed, found, get};

/// The lines of a table, each as an object by the header's names; empty cells are left out.
fn lines(csv: &[u8]) -> Vec<Value> {
    let mut reader = csv::Reader::from_reader(csv);
    let columns = reader.headers().unwrap().clone();
    let line = |record: csv::StringRecord| {
        let cells = columns.iter().zip(record.iter()).filter(|(_, cell)| !cell.is_empty());
        cells.map(|(column, cell)| (column.to_owned(), value(cell))).collect()
    };
    reader.records().map(|record| line(record.unwrap())).collect()
}

/// A number, if it is one.
fn value(cell: &str) -> Value {
    serde_json::from_str(cell).unwrap_or_else(|_| json!(cell))
}

#[tokio::test(flavor = "multi_thread")]
async fn tables_hold_what_the_lists_hold() {
    let Surveyed { server, .. } = Surveyed::start().await;
    let matches = found(&server, "/v1/maps/drive/loop-closures").await["loop_closures"].clone();
    assert!(matches.as_array().unwrap().len() > 1);
    assert_eq!(found(&server, "/v1/maps/drive/loop-closures.json").await, matches);
    let table = get(&server, "/v1/maps/drive/loop-closures.csv").await;
    assert_eq!(table.header("content-type"), "text/csv; charset=utf-8");
    assert_eq!(table.header("content-disposition"), "attachment; filename=\"drive-loop-closures.csv\"");
    let expected = matches.as_array().unwrap().iter().map(|found| {
        let (frame, matched) = (&found["frame"], &found["matched_frame"]);
        json!({
            "session": frame["session"], "sequence": frame["sequence"], "stamp_ns": frame["stamp_ns"],
            "matched_session": matched["session"], "matched_sequence": matched["sequence"],
            "matched_stamp_ns": matched["stamp_ns"], "place_number": found["place_number"], "posterior": found["posterior"],
            "probability": found["probability"],
        })
    });
    assert_eq!(lines(&table.body), expected.collect::<Vec<_>>());

    let mut frames = Vec::new();
    for session in ["first", "second"] {
        let path = format!("/v1/maps/drive/sessions/{session}/frames");
        let name = format!("maps/drive/sessions/{session}");
        let listed = found(&server, &path).await["frames"].clone();
        frames.extend(listed.as_array().unwrap().iter().map(|frame| in_short(&name, frame)));
    }
    assert_eq!(frames.len(), 25);
    assert_eq!(found(&server, "/v1/maps/drive/posteriors.json").await, json!(frames));
    let table = get(&server, "/v1/maps/drive/posteriors.csv").await;
    assert_eq!(table.header("content-disposition"), "attachment; filename=\"drive-posteriors.csv\"");
    assert_eq!(lines(&table.body), frames.iter().map(in_columns).collect::<Vec<_>>());
    server.stop().await;
}

/// The row of a frame.
fn in_short(session: &str, frame: &Value) -> Value {
    let answer = &frame["answer"];
    json!({
        "session": session, "sequence": answer["sequence"], "stamp_ns": frame["stamp_ns"], "note": frame["note"],
        "reason": answer["reason"],
        "place_number": answer["place_number"], "posterior": answer["posterior"],
        "new_place_posterior": answer["new_place_posterior"], "places": answer["places"],
    })
}

/// A row with its places in columns.
fn in_columns(row: &Value) -> Value {
    let mut columns = row.as_object().unwrap().clone();
    let places = columns.remove("places").unwrap();
    for (rank, place) in places.as_array().unwrap().iter().enumerate() {
        columns.insert(format!("place_number_{}", rank + 1), place["place_number"].clone());
        columns.insert(format!("posterior_{}", rank + 1), place["posterior"].clone());
    }
    columns.retain(|_, value| !value.is_null() && value != "");
    Value::Object(columns)
}

#[tokio::test(flavor = "multi_thread")]
async fn tables_of_an_empty_map_have_a_header_alone() {
    let Surveyed { server, .. } = Surveyed::start().await;
    for table in ["loop-closures", "posteriors"] {
        assert_eq!(found(&server, &format!("/v1/maps/empty/{table}.json")).await, json!([]));
        let csv = get(&server, &format!("/v1/maps/empty/{table}.csv")).await;
        assert!(csv.text().starts_with("session,sequence,stamp_ns,"), "{}", csv.text());
        assert_eq!(csv.text().lines().count(), 1, "{}", csv.text());
    }
    server.stop().await;
}
