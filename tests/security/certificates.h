#pragma once

#include <filesystem>
#include <string>

#include <stdlib.h>

#include <iotcloud/security/certificates.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::security::test {

/// A folder that is removed after the test.
class Folder {
 public:
  Folder() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-access-XXXXXX";
    path_ = mkdtemp(pattern.data());
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// An authority of its own, with a machine "lab1" and an "operator".
class Certificates {
 public:
  Certificates() {
    authority_.make();
    authority_.certify_host("lab1");
    authority_.certify_caller("operator");
  }
  TlsFiles of(const std::string& name) const {
    return {authority_.certificate("ca"), authority_.certificate(name), authority_.key(name)};
  }
  const Authority& authority() const { return authority_; }

 private:
  const Folder folder_;
  const Authority authority_{folder_ / "certs"};
};

}  // namespace iotcloud::security::test
