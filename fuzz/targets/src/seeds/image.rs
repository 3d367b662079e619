//! Images, and flashes with them.

use super::Seed;
use crate::byte_reader::bytes;

pub(super) fn image_seeds() -> Vec<Seed> {
    use host::image::sample;
    let file = sample::file("mill6", "5a-75b-8.0", 0x89ab_cdef, 40);
    let meta = host::image::Image::parse(&file).map(|image| image.meta().to_page());
    let stub = wire::images::Stub { target: 0x2_0000 }.to_page();
    vec![
        ("image", "bitstream", [vec![0], file].concat()),
        (
            "image",
            "bitstream_of_few_bytes",
            [vec![1], bytes(&[9, 0x4111_1043, 1])].concat(),
        ),
        ("image", "flash_as_built", vec![2]),
        ("image", "flash_of_another_stub", vec![2, 0, 36, 2, 9, 9]),
        (
            "image",
            "meta_page",
            [
                vec![3],
                meta.map_or(Vec::new(), |page| page[..100].to_vec()),
            ]
            .concat(),
        ),
        (
            "image",
            "stub_page",
            [vec![3], stub[..40].to_vec()].concat(),
        ),
    ]
}
