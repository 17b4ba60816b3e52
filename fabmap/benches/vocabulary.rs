//! Training and quantization of vocabularies on descriptors drawn around random centres.
#![expect(clippy::expect_used, reason = "a benchmark's own inputs are valid")]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::ops::ControlFlow;

/// As many descriptors as an image has.
const IMAGE_DESCRIPTORS: usize = 500;

/// Copies of random rows with noise: about what SIFT (128 bytes) and ORB (32 bytes) give.
fn descriptors(kind: DescriptorKind, rows: usize, seed: u64) -> Descriptors {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let width = match kind {
        DescriptorKind::Float => 128,
        DescriptorKind::Binary => 32,
    };
    let centres: Vec<u8> = (0..width * 1000).map(|_| random.random_range(0..120)).collect();
    let mut bytes = Vec::with_capacity(rows * width);
    for _ in 0..rows {
        let centre = random.random_range(0..1000) * width;
        for &value in &centres[centre..centre + width] {
            bytes.push(match kind {
                DescriptorKind::Float => value.saturating_add_signed(random.random_range(-30..=30)),
                DescriptorKind::Binary => value ^ (1 << random.random_range(0..8)),
            });
        }
    }
    Descriptors::new(kind, width, bytes).expect("whole rows")
}

fn train(descriptors: &Descriptors, words: u32, iterations: u32) -> Vocabulary {
    let settings = VocabularySettings { words, seed: 1, iterations };
    Vocabulary::train(descriptors, &settings, &mut |_| ControlFlow::Continue(())).expect("enough descriptors")
}

fn quantization(criterion: &mut Criterion) {
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut group = criterion.benchmark_group("quantize an image on one thread");
    group.throughput(Throughput::Elements(IMAGE_DESCRIPTORS as u64));
    for kind in [DescriptorKind::Float, DescriptorKind::Binary] {
        let image = descriptors(kind, IMAGE_DESCRIPTORS, 2);
        for words in [1_000, 5_000, Vocabulary::EXACT_WORDS_MAX, 60_000] {
            let vocabulary = train(&descriptors(kind, 65_000, 1), words, 1);
            group.bench_function(BenchmarkId::new(format!("{kind:?}"), words), |bencher| {
                bencher.iter(|| one_thread.install(|| black_box(vocabulary.words(black_box(&image)))));
            });
        }
    }
    group.finish();
}

fn training(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("train 1,000 words from 20,000 descriptors");
    group.sample_size(10);
    for kind in [DescriptorKind::Float, DescriptorKind::Binary] {
        let rows = descriptors(kind, 20_000, 1);
        group.bench_function(format!("{kind:?}"), |bencher| {
            bencher.iter(|| train(black_box(&rows), 1_000, 12));
        });
    }
    group.finish();
}

criterion_group!(benches, quantization, training);
criterion_main!(benches);
