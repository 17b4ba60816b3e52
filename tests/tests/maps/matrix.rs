//! Which places look alike: the match matrix against the plain equations, and lists that are thinned.

use fabmap::{Appearance, Observation, PlaceId};
use waypost_client::v1::matrix_mark::Kind;
use waypost_client::{Client, Code, v1};
use waypost_proto::v1::map_service_client::MapServiceClient;

use crate::harness::{
    Server, assert_status, by_words_request, channel, get, mapped, model_of_other_words, reference_by_words,
    refused, take_model,
};

/// The shades of a tile, row by row.
async fn shades(client: &Client, request: v1::GetMatchMatrixTileRequest) -> Vec<u8> {
    let png = client.match_matrix_tile(request).await.unwrap();
    let tile = image::load_from_memory_with_format(&png, image::ImageFormat::Png).unwrap();
    assert_eq!((tile.width(), tile.height(), tile.color()), (256, 256, image::ColorType::L8));
    tile.to_luma8().into_raw()
}

fn first_tile(map: &str, against: &str) -> v1::GetMatchMatrixTileRequest {
    let name = |map: &str| if map.is_empty() { String::new() } else { format!("maps/{map}") };
    v1::GetMatchMatrixTileRequest { map: name(map), against: name(against), ..Default::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_matrix_is_what_the_dense_equations_say_of_each_two_places() {
    const MAPPED: u64 = 110;
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "robot", 1..=MAPPED).await;
    let mapper = reference_by_words().mapper(MAPPED);
    let index = mapper.recognizer().index();
    let model = index.model();
    let looks: Vec<Observation> = index.appearances().map(|place| place.usual_look()).collect();
    let described = client.match_matrix("drive", None).await.unwrap();
    let numbers: Vec<u32> = (0..looks.len() as u32).collect();
    assert_eq!((&*described.map, &*described.against), ("maps/drive", "maps/drive"));
    assert_eq!((described.tile_cells, described.levels), (256, 1));
    for axis in [&described.rows, &described.columns] {
        let axis = axis.as_ref().unwrap();
        assert_eq!(axis.place_numbers, numbers);
        let session = "maps/drive/sessions/robot".to_owned();
        assert_eq!(axis.sessions, [v1::MatrixSession { session, first: 0, places: looks.len() as u32 }]);
    }

    let shown = shades(&client, first_tile("drive", "")).await;
    let mut alike = 0;
    for (row, look) in looks.iter().enumerate() {
        let somewhere_new = model.dense_log_likelihood_of_average_place(look);
        for (column, other) in looks.iter().enumerate() {
            let nats = model.dense_log_likelihood(look, &Appearance::of(other)) - somewhere_new;
            let exact = 255.0 * (nats / described.full_shade_nats).clamp(0.0, 1.0);
            let shade = f64::from(shown[256 * row + column]);
            assert!((shade - exact).abs() <= 0.5 + 1e-6, "{row}, {column}: {shade} for {exact}");
            alike += usize::from(row.abs_diff(column) > 1 && shade > 0.0);
        }
        let beyond = &shown[256 * row + looks.len()..256 * (row + 1)];
        assert!(beyond.iter().all(|&shade| shade == 0));
    }
    assert!(alike > 0, "no two places look alike");
    assert!(shown[256 * looks.len()..].iter().all(|&shade| shade == 0));

    // The robot came back at the end, so that closures join what is far from the diagonal.
    let closures = client.loop_closures("drive").await.unwrap();
    let marked = |kind| described.marks.iter().filter(move |mark| mark.kind() == kind);
    assert!(!closures.is_empty() && marked(Kind::LoopClosure).count() > 0, "{:?}", described.marks);
    for mark in marked(Kind::LoopClosure) {
        let ends = [mark.row, mark.column];
        assert!(closures.iter().any(|closure| ends.contains(&closure.place_number)), "{mark:?}");
    }
    for mark in marked(Kind::Link) {
        let linked = mapper.map().linked(PlaceId::new(mark.row));
        assert!(mark.row < mark.column && linked.contains(&PlaceId::new(mark.column)), "{mark:?}");
    }

    let path = "/v1/maps/drive/matrix/tiles/0/0/0";
    let over_rest = get(&server, path).await;
    assert_eq!(over_rest.header("content-type"), "image/png");
    assert_eq!(over_rest.body, client.match_matrix_tile(first_tile("drive", "")).await.unwrap());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_compared_with_another_of_its_model_and_with_no_other() {
    let (server, client) = Server::with_map().await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    mapped(&client, "robot", 1..=30).await;
    client.create_map(by_words_request("empty", &model)).await.unwrap();
    let described = client.match_matrix("drive", Some("empty")).await.unwrap();
    assert!(described.columns.as_ref().unwrap().place_numbers.is_empty());
    assert_eq!((&*described.against, described.marks.len()), ("maps/empty", 0));
    let turned = client.match_matrix("empty", Some("drive")).await.unwrap();
    assert_eq!((&turned.rows, &turned.columns), (&described.columns, &described.rows));
    let nothing = client.match_matrix_tile(first_tile("drive", "empty")).await;
    assert_status("nothing", in_words(&refused(nothing)), Code::NotFound, "0 tiles at level 0");

    let other = take_model(&client, "other", &model_of_other_words()).await;
    client.create_map(by_words_request("elsewhere", &other.name)).await.unwrap();
    let refusal = refused(client.match_matrix("drive", Some("elsewhere")).await);
    assert_status("words", in_words(&refusal), Code::FailedPrecondition, "have different models");
    let refusal = refused(client.match_matrix_tile(first_tile("drive", "elsewhere")).await);
    assert_status("words", in_words(&refusal), Code::FailedPrecondition, "waypost map rebuild");
    let deep = v1::GetMatchMatrixTileRequest { level: 1, ..first_tile("drive", "") };
    let refusal = refused(client.match_matrix_tile(deep).await);
    assert_status("level", in_words(&refusal), Code::InvalidArgument, "level 1 is none");
    let beyond = v1::GetMatchMatrixTileRequest { column: 1, ..first_tile("drive", "") };
    let refusal = refused(client.match_matrix_tile(beyond).await);
    assert_status("tile", in_words(&refusal), Code::NotFound, "1 x 1 tiles at level 0");
    server.stop().await;
}

fn in_words((code, message): &(Code, String)) -> (Code, &str) {
    (*code, message)
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_of_places_and_frames_are_thinned_by_who_asks() {
    let (server, client) = Server::with_map().await;
    mapped(&client, "robot", 1..=60).await;
    let all = client.places("drive").await.unwrap();
    assert!(all.len() > 12, "{}", all.len());
    let service = MapServiceClient::new(channel(&server.endpoint()).await);
    for (every, from, to) in
        [(1, 0, None), (3, 0, None), (3, 4, Some(9)), (7, 1, Some(6)), (5, u32::MAX, None)]
    {
        let wanted: Vec<&v1::Place> = all
            .iter()
            .enumerate()
            .filter(|&(number, _)| {
                let number = number as u32;
                number.is_multiple_of(every) && number >= from && to.is_none_or(|to| number <= to)
            })
            .map(|(_, place)| place)
            .collect();
        let (mut listed, mut page_token) = (Vec::new(), String::new());
        loop {
            let request = v1::ListPlacesRequest {
                map: "maps/drive".to_owned(),
                page_size: 2,
                page_token,
                every,
                from_place_number: from,
                to_place_number: to,
                within: None,
            };
            let page = service.clone().list_places(request).await.unwrap().into_inner();
            assert!(page.next_page_token.is_empty() || page.places.len() == 2);
            listed.extend(page.places);
            page_token = page.next_page_token;
            if page_token.is_empty() {
                break;
            }
        }
        assert_eq!(listed.iter().collect::<Vec<_>>(), wanted, "every {every} of {from} to {to:?}");
    }
    let within = "/v1/maps/drive/places?part=0&min_x_m=-9&max_x_m=9&min_y_m=-9&max_y_m=9";
    assert_eq!(get(&server, within).await.json()["places"].as_array().unwrap().len(), 0, "without odometry");
    let half = get(&server, "/v1/maps/drive/places?part=0&min_x_m=-9").await;
    assert!(half.status == 400 && half.text().contains("give all five, or none"), "{}", half.text());
    let turned = get(&server, &within.replace("min_x_m=-9", "min_x_m=10")).await;
    assert!(turned.status == 400 && turned.text().contains("must not be the smaller"), "{}", turned.text());

    let path = "/v1/maps/drive/sessions/robot/frames?page_size=5&from_sequence=41";
    let frames = get(&server, path).await.json();
    let sequences = frames["frames"].as_array().unwrap().iter().map(|frame| frame["name"].as_str().unwrap());
    let expected = (41..=45).map(|sequence| format!("maps/drive/sessions/robot/frames/{sequence}"));
    assert!(sequences.eq(expected), "{frames}");
    let more = format!("{path}&page_token={}", frames["next_page_token"].as_str().unwrap());
    let next = get(&server, &more).await.json();
    assert_eq!(next["frames"][0]["name"], "maps/drive/sessions/robot/frames/46");
    server.stop().await;
}
