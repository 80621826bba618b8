# Hot kernels are compiled once per instruction set and chosen at run time (common/math/isa.h).

# rg_isa_sources(TARGET file.cc …): adds each file three times to TARGET, for plain x86-64, for
# x86-64-v3 (AVX2, FMA) and for x86-64-v4 (AVX-512). Such a file includes kernel headers only: code
# of the standard library or Eigen compiled for a newer instruction set could be picked by the linker
# for everyone. All symbols it defines must live in the inline namespace RG_ISA. Kernels are optimised (-O3:
# small loops unrolled) in every build type but under sanitizers.
function(rg_isa_sources target)
  set(flags_v1 "")
  set(flags_v3 "-march=x86-64-v3")
  set(flags_v4 "-march=x86-64-v4;-mprefer-vector-width=512")
  set(optimised -O3)
  if(RG_SANITIZE)
    set(optimised "")
  endif()
  foreach(isa v1 v3 v4)
    add_library(${target}_isa_${isa} OBJECT ${ARGN})
    target_include_directories(${target}_isa_${isa} PRIVATE ${CMAKE_SOURCE_DIR})
    target_compile_options(${target}_isa_${isa} PRIVATE ${flags_${isa}} -Wno-psabi -fno-exceptions -fno-rtti
      -fno-trapping-math ${optimised})
    target_sources(${target} PRIVATE $<TARGET_OBJECTS:${target}_isa_${isa}>)
  endforeach()
endfunction()
