#pragma once

#include <memory>
#include <string>
#include <vector>

#include <iotcloud/bench/codec/frames.h>

namespace iotcloud::bench {

using Bytes = std::vector<std::byte>;

/// One way to compress depth frames, ours or a peer's. Reuses its buffers; never fails on its own output.
class Contestant {
 public:
  virtual ~Contestant() = default;
  virtual void encode(const Frame& disparities, Bytes& out) = 0;
  /// Ours give millimetres, which the follower needs; the peers give disparities.
  virtual void decode(const Bytes& bytes, Frame& out) = 0;
  virtual bool gives_mm() const { return false; }
};

struct Named {
  std::string name;
  std::unique_ptr<Contestant> contestant;
};

/// Ours ("reference", "compact", "lossless"), and the peers on the raw frame of 16-bit disparities.
std::vector<Named> all_contestants();

/// Run lengths and variable-length differences in groups of four bits (A. D. Wilson, Fast lossless depth image
/// compression, 2017).
std::unique_ptr<Contestant> make_rvl();
/// Prediction from the pixel before, then adaptive run lengths and Golomb-Rice codes (S. Mehrotra et al.,
/// Low-complexity, near-lossless coding of depth maps from Kinect-like depth cameras, 2011; H. Malvar, 2006).
std::unique_ptr<Contestant> make_mehrotra();

}  // namespace iotcloud::bench
