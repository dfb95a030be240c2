#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/description/fields.h>

namespace iotcloud::discovery {

/// A plugin that a gateway has.
struct KnownPlugin {
  std::string file;                 ///< as orders name it; empty: it was sent, and no instance runs it
  std::string sha256;               ///< of its bytes
  std::int64_t size = 0;            ///< bytes
  bool sent = false;                ///< false: it is in the gateway's plugin folder
  std::string signed_by{};          ///< the trusted key that signed it; empty: none
  std::int64_t signed_version = 0;  ///< the version that the signer gave; 0: none
  std::string problem{};            ///< why it would not run there; empty: nothing is known
  std::string declaration{};        ///< what it declares: JSON of config/declaration.h
  static constexpr const char* what = "a plugin of a gateway";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(file, usual),
                                            IOTCLOUD_FIELD(sha256, usual),
                                            IOTCLOUD_FIELD(size, usual),
                                            IOTCLOUD_FIELD(sent, usual),
                                            IOTCLOUD_FIELD_AS(signed_by, usual, "signed_by", signedBy),
                                            IOTCLOUD_FIELD_AS(signed_version, usual, "signed_version", signedVersion),
                                            IOTCLOUD_FIELD(problem, usual),
                                            IOTCLOUD_FIELD(declaration, usual)};
};

}  // namespace iotcloud::discovery
