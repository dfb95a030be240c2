// Orders, their removals, submissions, adoptions and marks of draining, with a master's signature, as they stand in the
// registry. The first byte chooses:
// what anybody wrote there, or an object that the master signed and that is then moved, changed or cut.
#include <filesystem>
#include <string>
#include <system_error>

#include <stdlib.h>

#include "iotcloud/config/error.h"
#include "iotcloud/discovery/freeze.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/submissions.h"
#include "iotcloud/security/signed_object.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include <iotcloud/tests/security/signer.h>

using namespace iotcloud;

namespace {

const std::string place = "/iot/gateways/lab1/orders/01";

/// A folder for the files of keys, which are trusted for as long as they are there.
struct Folder {
  Folder() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-fuzz-XXXXXX";
    path = std::string(mkdtemp(pattern.data())) + "/";
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string path;
};

/// A master's key, and those who trust it.
struct Master {
  const Folder folder;
  const security::test::Signer signer{folder.path, "master"};
  const security::TrustedKeys trusted{{.require_signature = true, .trusted_keys = {signer.public_file()}}};
};

const Master& the_master() {
  static const Master one;
  return one;
}

std::string signer(const std::string& where, const std::string& bytes) {
  return security::signer_of_object(the_master().trusted, where, bytes);
}

/// The record in the bytes, written again, or what is wrong with them.
template <typename Record>
std::string read(const std::string& bytes, Record (*decode)(const std::string&, const std::string&)) {
  try {
    return discovery::encode(decode(bytes, place));
  } catch (const config::Error& error) {
    fuzz::must(std::string(error.what()).starts_with(place), "an error names the node");
    return "";
  }
}

/// A reader passes over the signature.
template <typename Record>
void reads_the_same(const std::string& object, const std::string& bytes,
                    Record (*decode)(const std::string&, const std::string&)) {
  const std::string plain = read(object, decode);
  fuzz::must(plain.empty() || plain == read(bytes, decode), "a signed record is read as it was before");
}

/// Calls `use` with the reader of everything that masters sign.
template <typename Use>
void each_reader(const Use& use) {
  use(discovery::decode_order);
  use(discovery::decode_removal);
  use(discovery::decode_topology_order);
  use(discovery::decode_submission);
  use(discovery::decode_adoption);
  use(discovery::decode_drain);
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(signed_orders, 1'500) {
  if (size < 3) return;
  const std::string bytes(fuzz::text(data + 1, size - 1));
  if (*data % 2 == 0) {
    fuzz::must(signer(place, bytes).empty(), "what the master did not sign has no signature");
    each_reader([&](auto decode) { read(bytes, decode); });
    return;
  }
  const std::string object = bytes.substr(1);
  if (!object.ends_with('}') || object.find('"') == std::string::npos) return;  // an empty object is never signed
  const std::string with_signature = security::sign_object(the_master().signer.key(), place, object);
  fuzz::must(signer(place, with_signature) == "master", "what the master signed is signed");
  fuzz::must(signer(place + "0", with_signature).empty(), "a copy elsewhere is not signed");
  std::string changed = with_signature;
  changed[data[1] % changed.size()] ^= 1;
  fuzz::must(signer(place, changed).empty(), "nor is what was changed");
  fuzz::must(
      signer(place, with_signature.substr(0, with_signature.size() - 1 - data[1] % with_signature.size())).empty(),
      "nor is what was cut");
  each_reader([&](auto decode) { reads_the_same(object, with_signature, decode); });
}
