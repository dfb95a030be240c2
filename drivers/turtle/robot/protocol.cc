#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <type_traits>
#include <utility>

#include <openssl/crypto.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <openssl/rand.h>

#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {

namespace {

constexpr std::string_view magic = "IoTR";
constexpr std::size_t length_bytes = 4;
enum FrameFlags : std::uint8_t { has_truth = 1, is_repeated = 2, in_lock_step = 4, is_visible = 8, is_in_box = 16 };
constexpr std::uint8_t all_flags = 31;

class BodyWriter {
 public:
  explicit BodyWriter(Kind kind) : bytes_(length_bytes, '\0') { add(static_cast<std::uint8_t>(kind)); }
  template <typename Number>
  BodyWriter& add(Number number) {
    if constexpr (std::is_floating_point_v<Number>) {
      return add(std::bit_cast<std::uint64_t>(static_cast<double>(number)));
    } else {
      for (int shift = static_cast<int>(sizeof number) * 8 - 8; shift >= 0; shift -= 8) {
        bytes_ += static_cast<char>(static_cast<std::uint64_t>(number) >> shift & 255);
      }
      return *this;
    }
  }
  BodyWriter& add_bytes(std::span<const std::byte> bytes) {
    bytes_.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    return *this;
  }
  BodyWriter& add_text(std::string_view text) {
    bytes_ += text;
    return *this;
  }
  /// \param more bytes of the message that the caller sends after the returned ones.
  std::string done(std::size_t more = 0) {
    const auto length = static_cast<std::uint32_t>(bytes_.size() - length_bytes + more);
    for (std::size_t i = 0; i < length_bytes; ++i) bytes_[i] = static_cast<char>(length >> (24 - 8 * i) & 255);
    return std::move(bytes_);
  }

 private:
  std::string bytes_;
};

class BodyReader {
 public:
  explicit BodyReader(const Incoming& message) : rest_(*message.body) {}
  template <typename Number>
  Number take() {
    if constexpr (std::is_floating_point_v<Number>) {
      const double value = std::bit_cast<double>(take<std::uint64_t>());
      if (!std::isfinite(value)) throw ProtocolError("a number that is not finite");
      return value;
    } else {
      Number number = 0;
      for (const std::byte byte : take_bytes(sizeof number)) {
        number = static_cast<Number>(number << 8 | std::to_integer<Number>(byte));
      }
      return number;
    }
  }
  std::uint8_t take_byte() { return std::to_integer<std::uint8_t>(take_bytes(1)[0]); }
  std::span<const std::byte> take_bytes(std::size_t count) {
    if (rest_.size() < count) throw ProtocolError("a message that is too short");
    const auto bytes = rest_.first(count);
    rest_ = rest_.subspan(count);
    return bytes;
  }
  template <std::size_t count>
  std::array<std::byte, count> take_array() {
    std::array<std::byte, count> array;
    std::ranges::copy(take_bytes(count), array.begin());
    return array;
  }
  std::span<const std::byte> rest() { return std::exchange(rest_, {}); }
  void finish() const {
    if (!rest_.empty()) throw ProtocolError("a message that is too long");
  }

 private:
  std::span<const std::byte> rest_;
};

std::string printable(std::span<const std::byte> bytes, std::size_t most) {
  std::string text;
  for (const std::byte byte : bytes.first(std::min(bytes.size(), most))) {
    const char c = static_cast<char>(byte);
    text += c >= ' ' && c <= '~' ? c : '?';
  }
  return text;
}

}  // namespace

std::string write_hello(const Hello& hello) {
  const auto name = std::string_view(hello.name).substr(0, most_name_bytes);
  return BodyWriter(Kind::hello)
      .add_text(magic)
      .add(hello.version)
      .add(hello.silence_ms)
      .add_bytes(hello.nonce)
      .add_text(name)
      .done();
}

std::string write_challenge(const Challenge& challenge) {
  return BodyWriter(Kind::challenge)
      .add(challenge.silence_ms)
      .add_bytes(challenge.nonce)
      .add_bytes(challenge.proof)
      .done();
}

std::string write_proof(const Proof& proof) {
  return BodyWriter(Kind::proof).add_bytes(proof).done();
}

std::string write_refused(std::string_view reason) {
  return BodyWriter(Kind::refused).add_text(reason.substr(0, most_before_proof / 2)).done();
}

std::string write_drive(const Velocity& velocity) {
  return BodyWriter(Kind::drive).add(velocity.linear).add(velocity.angular).done();
}

std::string write_number(Kind kind, std::uint64_t number) {
  return BodyWriter(kind).add(number).done();
}

std::string write_bare(Kind kind) {
  return BodyWriter(kind).done();
}

std::string write_frame_head(const FrameHead& head, std::size_t encoded_bytes) {
  const auto& truth = head.truth;
  const int flags = (truth ? has_truth : 0) | (head.repeated ? is_repeated : 0) | (head.lock_step ? in_lock_step : 0) |
                    (truth && truth->visible ? is_visible : 0) | (truth && truth->in_box ? is_in_box : 0);
  BodyWriter writer(Kind::frame);
  writer.add(head.number).add(head.age_us).add(head.device_time_s).add(static_cast<std::uint8_t>(flags));
  if (truth) {
    writer.add(truth->robot_x).add(truth->robot_y).add(truth->robot_heading);
    writer.add(truth->person_x).add(truth->person_y).add(truth->distance).add(truth->render_us);
  }
  return writer.done(encoded_bytes);
}

Hello read_hello(const Incoming& message) {
  BodyReader reader(message);
  const auto found = reader.take_bytes(magic.size());
  if (std::memcmp(found.data(), magic.data(), magic.size()) != 0) throw ProtocolError("this is no iotcloud-robot");
  Hello hello;
  hello.version = reader.take<std::uint16_t>();
  if (hello.version != protocol_version) {
    throw ProtocolError("the agent speaks version " + std::to_string(hello.version) + " of the protocol, and this is " +
                        std::to_string(protocol_version) + ": install the same release on both");
  }
  hello.silence_ms = reader.take<std::uint32_t>();
  hello.nonce = reader.take_array<sizeof(Nonce)>();
  hello.name = printable(reader.rest(), most_name_bytes);
  return hello;
}

Challenge read_challenge(const Incoming& message) {
  BodyReader reader(message);
  Challenge challenge;
  challenge.silence_ms = reader.take<std::uint32_t>();
  challenge.nonce = reader.take_array<sizeof(Nonce)>();
  challenge.proof = reader.take_array<proof_bytes>();
  reader.finish();
  return challenge;
}

Proof read_proof(const Incoming& message) {
  BodyReader reader(message);
  const auto proof = reader.take_array<proof_bytes>();
  reader.finish();
  return proof;
}

std::string read_refused(const Incoming& message) {
  return printable(*message.body, most_before_proof);
}

Velocity read_drive(const Incoming& message) {
  BodyReader reader(message);
  Velocity velocity;
  velocity.linear = reader.take<double>();
  velocity.angular = reader.take<double>();
  reader.finish();
  return velocity;
}

std::uint64_t read_number(const Incoming& message) {
  BodyReader reader(message);
  const auto number = reader.take<std::uint64_t>();
  reader.finish();
  return number;
}

FrameHead read_frame(const Incoming& message, Payload& encoded) {
  BodyReader reader(message);
  FrameHead head;
  head.number = reader.take<std::uint64_t>();
  head.age_us = reader.take<std::uint32_t>();
  head.device_time_s = reader.take<double>();
  const std::uint8_t flags = reader.take_byte();
  if (flags > all_flags) throw ProtocolError("a frame with flags that this version does not know");
  head.repeated = (flags & is_repeated) != 0;
  head.lock_step = (flags & in_lock_step) != 0;
  if (flags & has_truth) {
    GroundTruth& truth = head.truth.emplace();
    for (double* value : {&truth.robot_x, &truth.robot_y, &truth.robot_heading, &truth.person_x, &truth.person_y,
                          &truth.distance, &truth.render_us}) {
      *value = reader.take<double>();
    }
    truth.visible = (flags & is_visible) != 0;
    truth.in_box = (flags & is_in_box) != 0;
  }
  encoded = Payload::wrap(message.body, reader.rest());
  if (encoded.empty()) throw ProtocolError("a frame without contents");
  return head;
}

std::optional<Incoming> MessageReader::take(std::span<const std::byte>& bytes) {
  while (!bytes.empty() && head_has_ < head_.size()) {
    head_[head_has_++] = bytes.front();
    bytes = bytes.subspan(1);
  }
  if (head_has_ < head_.size()) return std::nullopt;
  if (!body_) {
    std::size_t length = 0;
    for (std::size_t i = 0; i < length_bytes; ++i) length = length << 8 | std::to_integer<std::size_t>(head_[i]);
    if (length == 0 || length > most_bytes_) {
      throw ProtocolError("a message of " + std::to_string(length) + " bytes, where 1 to " +
                          std::to_string(most_bytes_) + " are allowed");
    }
    body_ = std::make_shared<std::vector<std::byte>>(length - 1);
    body_has_ = 0;
  }
  const std::size_t count = std::min(bytes.size(), body_->size() - body_has_);
  std::copy_n(bytes.begin(), count, body_->begin() + static_cast<std::ptrdiff_t>(body_has_));
  bytes = bytes.subspan(count);
  body_has_ += count;
  if (body_has_ < body_->size()) return std::nullopt;
  head_has_ = 0;
  return Incoming{static_cast<Kind>(head_[length_bytes]), std::exchange(body_, nullptr)};
}

Proof make_proof(Side side, std::string_view token, const Nonce& of_agent, const Nonce& of_driver) {
  std::array<std::byte, 1 + 2 * sizeof(Nonce)> text;
  text[0] = side == Side::agent ? std::byte{'a'} : std::byte{'d'};
  std::ranges::copy(of_agent, text.begin() + 1);
  std::ranges::copy(of_driver, text.begin() + 1 + sizeof(Nonce));
  Proof proof;
  unsigned size = 0;
  const char* key = token.empty() ? "" : token.data();  // a null pointer would mean the last key
  if (!HMAC(EVP_sha256(), key, static_cast<int>(token.size()), reinterpret_cast<const unsigned char*>(text.data()),
            text.size(), reinterpret_cast<unsigned char*>(proof.data()), &size) ||
      size != proof.size()) {
    throw std::runtime_error("OpenSSL cannot make an HMAC-SHA-256");
  }
  return proof;
}

bool same_proof(const Proof& a, const Proof& b) {
  return CRYPTO_memcmp(a.data(), b.data(), a.size()) == 0;
}

Nonce random_nonce() {
  Nonce nonce;
  if (RAND_bytes(reinterpret_cast<unsigned char*>(nonce.data()), static_cast<int>(nonce.size())) != 1) {
    throw std::runtime_error("OpenSSL has no random numbers");
  }
  return nonce;
}

}  // namespace iotcloud::drivers::turtle::robot
