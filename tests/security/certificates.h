#pragma once

#include <string>

#include <iotcloud/security/certificates.h>
#include <iotcloud/security/tls.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::security::test {

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
  const tests::TemporaryFolder folder_;
  const Authority authority_{folder_ / "certs"};
};

}  // namespace iotcloud::security::test
