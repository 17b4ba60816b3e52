//! Places in full, and the inverted index: as the log folds them.

use std::collections::BTreeMap;

use fabmap::PlaceId;
use waypost_client::v1;
use waypost_proto::v1::map_service_client::MapServiceClient;

use crate::harness::{Server, channel, mapped, reference};

#[tokio::test(flavor = "multi_thread")]
async fn places_are_told_as_the_log_folds_them() {
    const MAPPED: u64 = 60;
    let (server, client) = Server::with_map().await;
    mapped(&client, "robot", 1..=MAPPED).await;
    let mapper = reference().mapper(MAPPED);
    let listed = client.places("drive").await.unwrap();
    assert_eq!(listed.len(), mapper.map().places().len());
    let mut by_word: BTreeMap<u32, Vec<(u32, u32, u32)>> = BTreeMap::new();
    for (number, place) in (0_u32..).zip(&listed) {
        let whole = client.place(&place.name).await.unwrap();
        assert_eq!(&v1::Place { word_hits: Vec::new(), ..whole.clone() }, place);
        let appearance = mapper.recognizer().index().appearance(PlaceId::new(number)).unwrap();
        let hits: Vec<(u32, u32)> = whole.word_hits.iter().map(|word| (word.word, word.hits)).collect();
        let folded: Vec<(u32, u32)> =
            appearance.word_hits().map(|(word, hits)| (word.into(), hits.into())).collect();
        assert_eq!(hits, folded, "place {number}");
        assert_eq!((whole.looks, whole.words as usize), (appearance.looks().into(), hits.len()));
        let linked = mapper.map().linked(PlaceId::new(number)).iter().map(|place| place.number());
        assert_eq!(whole.linked_place_numbers, linked.collect::<Vec<_>>());
        let frames: Vec<u64> = whole.frames.iter().map(|frame| frame.sequence).collect();
        let learnt = mapper.map().places()[number as usize].frames.iter();
        assert_eq!(frames, learnt.map(|frame| reference().sequence_of(frame.frame)).collect::<Vec<_>>());
        for (word, hits) in hits {
            by_word.entry(word).or_default().push((number, hits, whole.looks));
        }
    }

    // The inverted index is the places' words, turned around.
    let common = by_word.iter().max_by_key(|(_, places)| places.len()).map(|(&word, _)| word).unwrap();
    assert!(by_word[&common].len() > 2, "no word is common");
    for (&word, places) in by_word.iter().filter(|(word, _)| *word % 23 == 0 || **word == common) {
        let told = client.word_places("drive", word).await.unwrap();
        let told: Vec<_> = told.iter().map(|place| (place.place_number, place.hits, place.looks)).collect();
        assert_eq!(&told, places, "word {word}");
    }
    let unseen = (0..).find(|word| !by_word.contains_key(word)).unwrap();
    assert_eq!(client.word_places("drive", unseen).await.unwrap(), []);

    let mut service = MapServiceClient::new(channel(&server.endpoint()).await);
    let (mut paged, mut page_token) = (Vec::new(), String::new());
    loop {
        let map = "maps/drive".to_owned();
        let request = v1::ListWordPlacesRequest { map, word: common, page_size: 1, page_token };
        let page = service.list_word_places(request).await.unwrap().into_inner();
        assert_eq!(page.places.len(), 1);
        paged.extend(page.places.iter().map(|place| (place.place_number, place.hits, place.looks)));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(paged, by_word[&common]);
    server.stop().await;
}
