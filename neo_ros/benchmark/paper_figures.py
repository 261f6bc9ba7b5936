"""
What the paper reports: PSNR, SSIM, LPIPS (VGG) of the whole image, on its own scenes.

Yu et al., NeRF-Enhanced Outpainting for Faithful Field-of-View Extrapolation, tables 1 and 2.
Whether the observed centre was pasted in is not said there.
"""

PAPER_SCENES = {'square': ('Replica', 'Gibson', 'HM3D'), 'horizontal': ('ScanNet',)}
# method -> scene -> (PSNR, SSIM, LPIPS)
PAPER = {
    'naive': {'Replica': (20.59, .781, .348), 'Gibson': (18.05, .705, .404),
              'HM3D': (17.92, .630, .427), 'ScanNet': (19.98, .755, .188)},
    'warping': {'Replica': (19.03, .745, .397), 'Gibson': (16.61, .688, .496),
                'HM3D': (15.94, .582, .512), 'ScanNet': (21.02, .755, .238)},
    'relocalized': {'Replica': (16.78, .724, .386), 'Gibson': (14.90, .641, .474),
                    'HM3D': (14.43, .602, .484), 'ScanNet': (18.88, .695, .188)},
    'NEO': {'Replica': (25.94, .868, .217), 'Gibson': (23.53, .822, .263),
            'HM3D': (21.54, .731, .338), 'ScanNet': (22.40, .793, .168)},
    'oracle': {'Replica': (32.90, .936, .174), 'Gibson': (32.16, .928, .188),
               'HM3D': (27.03, .824, .299), 'ScanNet': (23.80, .805, .108)},
}
