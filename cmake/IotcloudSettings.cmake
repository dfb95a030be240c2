# Compiler settings that hold for every target, and the one include path.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_CXX_VISIBILITY_PRESET hidden)
set(CMAKE_VISIBILITY_INLINES_HIDDEN ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)
set(CMAKE_LIBRARY_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/plugins)

# Code that no message passes through is compiled fast rather than made fast; HOT targets (IotcloudTargets.cmake) are
# compiled with -O3.
set(CMAKE_CXX_FLAGS_RELEASE "-O1 -DNDEBUG")

option(IOTCLOUD_UNITY "Compile several sources of a target as one translation unit" OFF)

set(IOTCLOUD_SANITIZE "" CACHE STRING "Sanitizers to build with, as for -fsanitize=")
set(IOTCLOUD_SANITIZE_OPTIMIZE 0 CACHE STRING "How far to optimize what is sanitized: at 0 it compiles in half the time")
if(IOTCLOUD_SANITIZE)
  add_compile_options(-fsanitize=${IOTCLOUD_SANITIZE} -fno-omit-frame-pointer -g1 -O${IOTCLOUD_SANITIZE_OPTIMIZE})
  add_link_options(-fsanitize=${IOTCLOUD_SANITIZE})
  add_compile_definitions(_GLIBCXX_ASSERTIONS)  # the library checks its preconditions: an index, a span's length
  add_compile_definitions(IOTCLOUD_SANITIZED)
  if(IOTCLOUD_SANITIZE MATCHES address)
    add_compile_definitions(IOTCLOUD_SANITIZED_ADDRESS)
  endif()
  if(IOTCLOUD_SANITIZE MATCHES undefined)
    add_compile_options(-fno-sanitize-recover=undefined)
    if(NOT IOTCLOUD_SANITIZE MATCHES fuzzer)
      # These checks are a third of the time to compile. Under asan the use of a null pointer ends the program anyway;
      # the preset fuzz checks alignment where bytes are decoded.
      add_compile_options(-fno-sanitize=null,alignment)
    endif()
    if(CMAKE_CXX_COMPILER_ID STREQUAL Clang)
      # A plugin's entry may be of another SDK, with another type: its first field tells, and the gateway refuses it.
      add_compile_options(-fno-sanitize=function)
    endif()
  endif()
endif()

# lld links in a third of the time; sanitized programs have 100 MB and more.
find_program(LLD_PROGRAM ld.lld)
if(LLD_PROGRAM)
  add_link_options(-fuse-ld=lld)
endif()

set(IOTCLOUD_PRECOMPILE "" CACHE STRING "For which of rooms;tests common headers are parsed once: IotcloudPrecompiled.cmake")

find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CCACHE_PROGRAM})
  if(IOTCLOUD_PRECOMPILE)
    # Without these settings ccache does not cache sources that use a precompiled header.
    set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros ${CCACHE_PROGRAM})
    add_compile_options($<$<CXX_COMPILER_ID:GNU>:-fpch-preprocess>)
  endif()
endif()

add_library(iotcloud_warnings INTERFACE)
target_compile_options(iotcloud_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual -Wold-style-cast -Wcast-qual
  -Wconversion -Wno-sign-conversion -Wimplicit-fallthrough -Werror
  # GCC 12 warns wrongly about std::string's operator+ (its bug 105651).
  $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>
  $<$<CXX_COMPILER_ID:Clang>:-Wthread-safety>)
if(IOTCLOUD_UNITY AND CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  # GCC takes the anonymous namespaces of sources in a unity build for those of headers.
  target_compile_options(iotcloud_warnings INTERFACE -Wno-subobject-linkage)
endif()
if(IOTCLOUD_UNITY AND CMAKE_CXX_COMPILER_ID STREQUAL Clang)
  # In a unity build a name of one source's anonymous namespace is visible in the next source; Clang calls that shadowing.
  target_compile_options(iotcloud_warnings INTERFACE -Wno-shadow)
endif()
if(rooms IN_LIST IOTCLOUD_PRECOMPILE AND CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  # With sanitizers or precompiled headers GCC gives these warnings wrongly.
  target_compile_options(iotcloud_warnings INTERFACE -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread
                                                     -Wno-maybe-uninitialized)
endif()

# The include path equals the path on disk, in the tree and installed: <iotcloud/brokers/message.h>.
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/include)
file(CREATE_LINK ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}/include/iotcloud SYMBOLIC)
# The Thrift compiler's output: "iotcloud/discovery/records_types.h" below this folder.
set(IOTCLOUD_GENERATED_DIR ${PROJECT_BINARY_DIR}/generated)
file(MAKE_DIRECTORY ${IOTCLOUD_GENERATED_DIR})
